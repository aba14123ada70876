"""A disk that fills up while a recording is made, or Ctrl-C: the file is named, and no half recording stays.
A log that exists stays, too.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from common import UserError
from recorder import LogWriter, import_udacity
from recorder.sources.built_in_simulator import record_simulated
from recorder.sources.recording_kinds import import_recording
from recorder.sources.settings import SimulatedDrive
from recorder.sources.udacity_follow import watch_udacity
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import PATIENCE_S, Process, command
from tests.helpers.lerobot_folders import as_image, image_feature, numbers_feature, write_dataset
from tests.helpers.logs import read_messages
from tests.helpers.other_logs import DRIVE, ROS_TOPICS, TOPICS, write_bag, write_mcap
from tests.helpers.tubs import record_2, write_tub_2
from tests.helpers.udacity import jpeg, make_recording, paths

LIMIT_BYTES = 2_000  # less than a picture has
SHORT_DRIVE = SimulatedDrive(laps=0.005)


def recording(folder: Path) -> Path:
    make_recording(folder, "".join(f"{paths(number)},0,1,0,9.5\n" for number in range(3)))
    return folder


def tub(folder: Path) -> Path:
    return write_tub_2(folder, map(record_2, range(4)))


def mcap(folder: Path) -> Path:
    return write_mcap(folder, DRIVE)


def bag(folder: Path) -> Path:
    return write_bag(folder, StoragePlugin.SQLITE3)


def dataset(folder: Path) -> Path:
    pictures = [as_image(jpeg(100 + row, row + 1)) for row in range(4)]
    features = {"observation.images.front": image_feature(), "action": numbers_feature(["steering"], 1)}
    return write_dataset(folder, features, {"observation.images.front": pictures, "action": [0.5] * 4}, [4])


each_kind = pytest.mark.parametrize(
    ("make", "record"),
    [
        (recording, import_udacity),
        (tub, import_recording),
        (mcap, lambda source, log, **force: import_recording(source, log, TOPICS, kind="log", **force)),
        (bag, lambda source, log, **force: import_recording(source, log, ROS_TOPICS, **force)),
        (dataset, import_recording),
        (recording, lambda _, log, **force: record_simulated(SHORT_DRIVE, log, **force)),
    ],
    ids=["Udacity", "tub", "mcap", "bag", "LeRobot", "built-in"],
)


@each_kind
def test_an_existing_log_is_replaced_only_if_asked(
    tmp_path: Path, make: Callable[[Path], Path], record: Callable[..., object]
) -> None:
    source, log = make(tmp_path / "source"), tmp_path / "log.mcap"
    log.write_bytes(b"somebody's work")
    with pytest.raises(UserError, match="--force"):
        record(source, log)
    assert log.read_bytes() == b"somebody's work"
    record(source, log, overwrite=True)
    assert read_messages(log)["/vehicle"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.mcap", "source"]


@each_kind
def test_nothing_of_an_import_stays(
    tmp_path: Path, make: Callable[[Path], Path], record: Callable[..., object]
) -> None:
    source = make(tmp_path / "source")
    log = tmp_path / "sessions" / "log.mcap"
    with files_of_at_most(LIMIT_BYTES), pytest.raises(UserError, match=r"log\.mcap: cannot be written \(File too"):
        record(source, log)
    assert [path.name for path in tmp_path.iterdir()] == ["source"]


def test_what_was_watched_is_kept_and_named(tmp_path: Path) -> None:
    folder, log = recording(tmp_path / "drive"), tmp_path / "log.mcap"
    with files_of_at_most(LIMIT_BYTES), pytest.raises(UserError, match=r"bc-log recover .*\.part"):
        watch_udacity(folder, log, idle_s=0)
    assert sorted(re.sub(r"[0-9a-f]{6}", "x", path.name) for path in tmp_path.iterdir()) == [
        "drive",
        "log.mcap.x.part",
    ]


@pytest.mark.parametrize("is_there", [True, False], ids=["an empty folder", "a new folder"])
def test_nothing_of_a_folder_for_the_real_simulator_stays(tmp_path: Path, is_there: bool) -> None:
    folder = tmp_path / "as" / "recorded"
    if is_there:
        folder.mkdir(parents=True)
    with (
        files_of_at_most(LIMIT_BYTES),
        pytest.raises(UserError, match=r"as/recorded: cannot be written \(File too"),
    ):
        record_simulated(SHORT_DRIVE, tmp_path / "sessions" / "x.mcap", udacity=folder)
    assert sorted(tmp_path.rglob("*")) == ([folder.parent, folder] if is_there else [])


def test_a_log_without_a_message_is_not_advised_to_be_recovered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recorder.log.writer.FLUSH_S", 0.0)
    writer = LogWriter(tmp_path / "run.mcap", {"source": "drive"}, live=True)
    with files_of_at_most(10), pytest.raises(UserError, match=r"run.mcap: cannot be written .*nothing was kept"):
        writer.flush_if_due()
    writer.__exit__(UserError)
    assert not list(tmp_path.iterdir())


def test_a_folder_does_not_stay_without_its_log(tmp_path: Path) -> None:
    """The pictures fit, the log does not."""
    with files_of_at_most(60_000), pytest.raises(UserError, match=r"x\.mcap: cannot be written"):
        record_simulated(SHORT_DRIVE, tmp_path / "x.mcap", udacity=tmp_path / "recorded")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_empty_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "recorded").mkdir()
    (tmp_path / "recorded" / "mine").touch()
    with pytest.raises(UserError, match="recorded: not empty"):
        record_simulated(SHORT_DRIVE, tmp_path / "x.mcap", udacity=tmp_path / "recorded")
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "recorded", tmp_path / "recorded" / "mine"]


def test_a_file_in_the_place_of_the_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "recorded").touch()
    with pytest.raises(UserError, match="recorded: cannot be written"):
        record_simulated(SHORT_DRIVE, tmp_path / "x.mcap", udacity=tmp_path / "recorded")
    assert list(tmp_path.iterdir()) == [tmp_path / "recorded"]


def test_ctrl_c_leaves_no_half_recording(tmp_path: Path) -> None:
    folder = tmp_path / "recorded"
    line = command("bc-record", "x", "--laps", 50, "--udacity", folder, "--sessions", tmp_path / "sessions")
    with Process(line) as process:
        deadline_s = time.monotonic() + PATIENCE_S
        while not list(folder.glob("IMG/*.jpg")):
            assert process.popen.poll() is None
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        assert not (folder / "driving_log.csv").exists()  # its name says that it is whole
        assert process.end() == 130
    assert list(tmp_path.iterdir()) == []
