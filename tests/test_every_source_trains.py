"""What other cars and programs have recorded is trained on: from the sources to a run, by the commands alone."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from rosbags.rosbag2 import StoragePlugin

from dataset.cli import main as bc_index
from model.cli import main as bc_train
from recorder.cli import main as bc_record
from recorder.import_cli import main as bc_import
from tests.helpers.driving import road_jpeg
from tests.helpers.other_logs import CAMERA, write_bag
from tests.helpers.repository import ROOT
from tests.helpers.tubs import record_1, record_2, write_tub_1, write_tub_2
from tests.helpers.udacity import call

PICTURES = 60
STEERING = [math.sin(number / 5) * 0.8 for number in range(PICTURES)]


def tub_1(folder: Path) -> list[object]:
    records = {number: record_1(number, **{"user/angle": value}) for number, value in enumerate(STEERING)}
    return [write_tub_1(folder, records, pictures=range(PICTURES))]


def tub_2(folder: Path) -> list[object]:
    records = [record_2(number, **{"user/angle": value}) for number, value in enumerate(STEERING)]
    # other pictures than the other tub's: two sessions with the same picture are refused
    written = write_tub_2(folder, records, pictures=[])
    for number in range(PICTURES):
        (folder / "images" / f"{number}_cam_image_array_.jpg").write_bytes(road_jpeg(number))
    return [written]


def ros_2_bag(folder: Path) -> list[object]:
    rows = [(number / 10, value, road_jpeg(100 + number)) for number, value in enumerate(STEERING)]
    bag = write_bag(folder, StoragePlugin.SQLITE3, rows=rows)
    return [bag, "--image", CAMERA, "--steering", "/cmd_vel.angular.z", "--steering-scale", -1]


def car_racing(folder: Path) -> list[object]:
    settings = f"{(ROOT / 'examples/car_racing.toml').read_text()}args.max_episode_steps = {PICTURES}"
    (race := folder.with_suffix(".toml")).write_text(settings)
    return ["gym", race, folder.name, "--expert", f"{ROOT / 'examples' / 'car_racing_expert.py'}:drive"]


SOURCES: dict[str, tuple[Callable[[], None], Callable[[Path], list[object]]]] = {
    "tub_1": (bc_import, tub_1),
    "tub_2": (bc_import, tub_2),
    "bag": (bc_import, ros_2_bag),
    "race": (bc_record, car_racing),
}


@pytest.mark.needs("box2d")
def test_tubs_of_both_versions_a_bag_and_an_environment_are_trained_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, (command, write) in SOURCES.items():
        assert call(command, *write(tmp_path / name)) == 0
        printed = capsys.readouterr()
        first = (
            r"1 episode driven to the end, with a reward of .*\n" if name == "race" else f".*{PICTURES} rows, .*\n"
        )
        assert re.fullmatch(f"{first}next: .*\n", printed.err)
        assert f"{PICTURES} rows, {PICTURES} pictures" in printed.out
    # some seconds of driving: the usual blocks, and the margin around them, would leave nothing to train on
    assert call(bc_index, "--block-s", 1, "--gap-s", 0, "--no-balance", "--no-flip") == 0
    samples = pq.read_table(tmp_path / "index" / "samples.parquet")
    assert Counter(samples["session"].to_pylist()) == dict.fromkeys(SOURCES, PICTURES)
    assert (
        call(bc_train, "--network", "small", "--epochs", 1, "--batch", 32, "--name", "first", "--threads", 1) == 0
    )
    written = {path.name for path in (tmp_path / "runs" / "first").iterdir()}
    assert written >= {"model.safetensors", "config.json", "metrics.jsonl"}


def test_what_learnt_from_tubs_goes_to_the_car(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """There is no simulator of its road: `bc-drive` would wait for one."""
    monkeypatch.chdir(tmp_path)
    assert call(bc_import, *tub_2(tmp_path / "tub"), "track") == 0
    assert call(bc_index, "--block-s", 1, "--gap-s", 0) == 0
    few = ("--network", "small", "--epochs", 1, "--batch", 32, "--threads", 1)
    assert call(bc_train, *few, "--name", "first") == 0
    printed = capsys.readouterr().out.replace(".venv/bin/", "")
    assert "; drive with `bc-train export first --donkeycar car`" in printed
    assert "bc-drive" not in printed
    assert call(bc_train, "export", "first", "--donkeycar", "car") == 0
    assert Path("car/first.onnx").is_file()
