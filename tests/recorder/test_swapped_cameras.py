"""Side cameras that are swapped: found by `bc-log check`, in pictures of the built-in simulator's cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.car import CAMERAS
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.reader import Log
from recorder.log_cli import main as log_main
from recorder.upkeep.swapped_cameras import swapped_cameras
from simulator.driving.simulation import Simulation
from tests.helpers.udacity import call

MOMENTS = 24


@pytest.fixture(scope="module")
def seen() -> list[list[bytes]]:
    """JPEGs of the centre, left and right camera in six places of the lake."""
    lake = Simulation("lake")
    result = []
    for number in range(6):
        lake.course.start(number * lake.track.line.length_m / 6)
        result.append([lake.jpeg(camera) for camera in CAMERAS])
    return result


def log_of(path: Path, moments: Sequence[Sequence[bytes]]) -> Path:
    with LogWriter(path, {"source": "test"}) as writer:
        for row in range(MOMENTS):
            for camera, picture in zip(CAMERAS, moments[row % len(moments)], strict=True):
                writer.picture(camera, row * 10**8, row, picture)
            writer.vehicle(row * 10**8, row, VehicleState(steering=row / 100, speed_mph=9.0))
    return path


def jpeg(picture: np.ndarray) -> bytes:
    ok, encoded = cv2.imencode(".jpg", picture)
    assert ok
    return encoded.tobytes()


def test_a_check_finds_them(tmp_path: Path, seen: list[list[bytes]], capsys: pytest.CaptureFixture[str]) -> None:
    log_of(tmp_path / "sound.mcap", seen)
    log_of(tmp_path / "swapped.mcap", [[centre, right, left] for centre, left, right in seen])
    assert call(log_main, "check", tmp_path / "sound.mcap") == 0
    assert "side cameras" not in capsys.readouterr().out
    assert call(log_main, "check", tmp_path / "swapped.mcap") == 3
    assert (
        "side cameras that are swapped: 1 (left and right; `bc-index --cameras center`" in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("order", "words"), [((1, 0, 2), "center and left"), ((2, 1, 0), "center and right"), ((1, 2, 0), "all three")]
)
def test_a_swapped_centre_camera_is_found(
    order: Sequence[int], words: str, tmp_path: Path, seen: list[list[bytes]], capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_of(tmp_path / "a.mcap", [[pictures[at] for at in order] for pictures in seen])
    assert call(log_main, "check", log) == 3
    assert f"  cameras that are swapped: 1 ({words}; import the recording again)" in capsys.readouterr().out


def test_a_camera_with_the_pictures_of_another_is_found(
    tmp_path: Path, seen: list[list[bytes]], capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_of(tmp_path / "a.mcap", [[centre, centre, right] for centre, _, right in seen])
    assert call(log_main, "check", log) == 3
    assert "  cameras with the same pictures: 1 (center and left; " in capsys.readouterr().out


def test_pictures_that_show_nothing_are_not_called_swapped(tmp_path: Path, seen: list[list[bytes]]) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (5, 3, 160, 320), dtype=np.uint8)
    black = np.zeros((160, 320), np.uint8)
    moments = {
        "noise": [[jpeg(picture) for picture in pictures] for pictures in noise],
        "same": [[centre] * 3 for centre, _, _ in seen],  # a recorder that keeps one camera's three times
        "black": [[jpeg(black)] * 3],
        "flat": [[jpeg(black[:9])] * 3],
        "sizes": [[jpeg(black), jpeg(black[:80]), jpeg(black)]],
        "one side": [[centre, right, right] for centre, left, right in seen],
    }
    for name, pictures in moments.items():
        with Log(log_of(tmp_path / f"{name}.mcap", pictures)) as log:
            assert not swapped_cameras(log), name


@pytest.mark.parametrize("name", ["jungle_linux", "lake_14hz", "lake_windows", "mountain_linux"])
def test_udacitys_cameras_are_called_as_they_are(tmp_path: Path, name: str, recordings: Path) -> None:
    images = recordings / name / "IMG"
    centres = sorted(images.glob("center_*.jpg"))
    chosen = [path.name for path in centres[:: len(centres) // MOMENTS]]
    moments = [[(images / name.replace("center", camera)).read_bytes() for camera in CAMERAS] for name in chosen]
    with Log(log_of(tmp_path / "a.mcap", moments)) as log:
        assert not swapped_cameras(log)
    with Log(log_of(tmp_path / "b.mcap", [[centre, right, left] for centre, left, right in moments])) as log:
        assert swapped_cameras(log) == "left and right"
