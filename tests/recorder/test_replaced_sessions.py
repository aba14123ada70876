"""What is there already is replaced only if asked: sessions, and folders in the layout of Udacity's simulator."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from common import UserError
from recorder import import_udacity
from recorder.sources.built_in_simulator import record_simulated
from recorder.sources.import_recording import import_recording
from recorder.sources.settings import SimulatedDrive
from tests.helpers.lerobot_folders import as_image, image_feature, numbers_feature, write_dataset
from tests.helpers.logs import read_messages
from tests.helpers.other_logs import DRIVE, ROS_TOPICS, TOPICS, write_bag, write_mcap
from tests.helpers.tubs import record_2, write_tub_2
from tests.helpers.udacity import jpeg, make_recording, paths

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
