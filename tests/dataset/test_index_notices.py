"""What bc-index says beside its tables: once, and where somebody can do something about it."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.car import Camera
from dataset import sessions_not_indexed
from dataset.cli import main
from dataset.index.sessions import unfinished_recordings
from tests.helpers.logs import write_log
from tests.helpers.udacity import call

pytestmark = pytest.mark.usefixtures("cwd")

STEERING = [round(0.02 * (row % 40) - 0.4, 2) for row in range(300)]  # 30 s


def log_of(name: str, width: int = 0, height: int = 0) -> Path:
    """A log whose pictures are no other session's: of this size, or else none at all."""

    def picture(camera: Camera, row: int) -> bytes:
        of_its_own = os.fsencode(f"{name} {camera} {row}")
        if not width:
            return of_its_own
        encoded = cv2.imencode(".jpg", np.full((height, width, 3), 3 * row + 60, np.uint8))[1]
        return encoded.tobytes() + of_its_own

    return write_log(Path("sessions") / f"{name}.mcap", STEERING[:60] if width else STEERING, picture)


def test_sessions_that_were_not_chosen_are_reported_once(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("lake", "mountain", "jungle"):
        log_of(name)
    assert call(main, "lake") == 0
    reported = "index: does not hold jungle, mountain; `bc-index` without names indexes all of sessions"
    assert reported in capsys.readouterr().err
    assert sessions_not_indexed("index", "sessions") == []  # which is what a training asks
    log_of("newer")
    assert sessions_not_indexed("index", "sessions") == ["newer"]
    assert call(main, "lake") == 0  # the same index, and by now another choice
    assert sessions_not_indexed("index", "sessions") == []
    capsys.readouterr()
    assert call(main) == 0
    assert "does not hold" not in capsys.readouterr().err
    assert sessions_not_indexed("index", "sessions") == []


def test_a_log_that_was_left_out_is_reported_again_when_it_has_changed(capsys: pytest.CaptureFixture[str]) -> None:
    log_of("lake")
    bad = Path("sessions/bad.mcap")
    bad.write_bytes(b"no log")
    assert call(main) == 3
    assert sessions_not_indexed("index", "sessions") == []
    bad.unlink()
    log_of("bad")
    assert sessions_not_indexed("index", "sessions") == ["bad"]


def test_a_session_that_is_mistyped_is_asked_back(capsys: pytest.CaptureFixture[str]) -> None:
    log_of("lake")
    assert call(main, "laek") == 1
    assert "laek.mcap: no such log; did you mean lake?" in capsys.readouterr().err
    assert call(main, "beach") == 1
    assert "no such log; the sessions are named by the files in sessions" in capsys.readouterr().err


def test_a_path_that_is_no_log_is_reported_by_what_may_be_meant(capsys: pytest.CaptureFixture[str]) -> None:
    log_of("lake")
    assert call(main, "sessions/lake") == 1
    assert "bc-index: sessions/lake: no such log; did you mean lake?" in capsys.readouterr().err
    recording = Path("my simulator/recording")
    recording.mkdir(parents=True)
    (recording / "driving_log.csv").touch()
    assert call(main, recording) == 1
    reported = "this is a recording; `bc-import 'my simulator/recording' NAME` converts it to a log"
    assert reported in capsys.readouterr().err


def test_pictures_of_different_sizes_are_reported_each_time(capsys: pytest.CaptureFixture[str]) -> None:
    log_of("lake", 320, 160)
    assert call(main, "--validation-share", 0) == 0
    assert "different sizes" not in capsys.readouterr().err
    log_of("tub", 160, 120)
    log_of("mountain", 320, 160)
    for _ in range(2):
        assert call(main, "--validation-share", 0) == 0
        printed = capsys.readouterr().err
        assert "pictures of different sizes: 320 x 160 px in lake, mountain; 160 x 120 px in tub." in printed


def test_a_finished_recording_whose_name_was_taken_is_not_recovered(tmp_path: Path) -> None:
    first, second = (write_log(tmp_path / f"{name}.mcap", [0.1] * 9) for name in ("lake", "second"))
    part = second.rename(tmp_path / "lake.mcap.0a1b2c.part")
    (line,) = unfinished_recordings(tmp_path, [])
    assert line == f"{part}: not indexed: its recording is finished; rename it to another NAME.mcap"
    first.unlink()
    (line,) = unfinished_recordings(tmp_path, [])
    assert line.endswith("is finished; rename it to lake.mcap")
