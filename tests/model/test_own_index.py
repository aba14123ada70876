"""One command trains on a few sessions, or learns from takeovers: it builds the index of its own."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from common.car import Camera
from model.cli import main
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.log.writer import LogWriter
from tests.helpers.driving import one_line_in, road_jpeg
from tests.helpers.logs import START_NS, STEP_NS, write_log
from tests.helpers.udacity import call

SMALL = ("--network", "small", "--epochs", "1")
TAKEN = range(20, 40)
"""The rows of the drive that a person drove."""


def supervised_drive(path: Path, first: int = 1000, taken: range = TAKEN) -> Path:
    """A network drives straight on; a person who takes over steers to the left."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with LogWriter(path, {"source": "drive", "run": "first"}) as writer:
        for row in range(60):
            now_ns = START_NS + row * STEP_NS
            steering = -0.4 if row in taken else 0.0
            driver = PilotCommand.HUMAN if row in taken else PilotCommand.PILOT
            writer.picture("center", now_ns, row, road_jpeg(first + row))
            writer.vehicle(now_ns, row, VehicleState(steering=steering, throttle=0.2, speed_mph=9.0))
            writer.command(now_ns, row, PilotCommand(driver=driver, steering=steering, throttle=0.2))
    return path


@pytest.fixture
def project(cwd: Path) -> Path:
    """Two sessions that differ, and no index."""
    for name, first in (("lake", 0), ("other", 500)):
        pictures = [road_jpeg(first + row) for row in range(100)]

        def picture(camera: Camera, row: int, pictures: list[bytes] = pictures) -> bytes:
            return pictures[row]

        steering = [0.3 * math.sin(row / 5) for row in range(100)]
        write_log(Path("sessions") / f"{name}.mcap", steering, picture, step_ns=5 * STEP_NS)
    return cwd


def sessions_in(index: str) -> dict[str, set[int]]:
    """The rows of each session that an index trains on."""
    rows: dict[str, set[int]] = {}
    for sample in pq.read_table(Path(index) / "samples.parquet").to_pylist():
        rows.setdefault(sample["session"], set()).add(sample["row"])
    return rows


def test_training_on_one_session_leaves_the_others_out(project: Path) -> None:
    assert call(main, "--name", "first", "--on", "lake", *SMALL) == 0
    assert set(sessions_in("index-first")) == {"lake"}
    assert not Path("index").exists()


def test_takeovers_are_learnt_on_top_of_all_that_was_learnt_before(project: Path) -> None:
    assert call(main, "--name", "first", "--on", "lake", *SMALL) == 0
    drives = [supervised_drive(Path(f"drives/{name}.mcap"), first) for name, first in (("a", 1000), ("b", 2000))]
    for name, init, drive in (("second", "first", drives[0]), ("third", "second", drives[1])):
        assert call(main, "continue", init, "--name", name, "--takeovers", drive, "--epochs", "1") == 0
    rows = sessions_in("index-third")
    assert set(rows) == {"lake", "a", "b"}
    assert rows["a"] | rows["b"] <= set(TAKEN)
    assert set(sessions_in("index-second")) == {"lake", "a"}
    config = json.loads(Path("runs/second/config.json").read_text())
    assert (config["init"]["run"], config["training"]["network"]) == ("first", "small")


def test_takeovers_that_were_learned_before_are_named(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "--name", "first", "--on", "lake", *SMALL) == 0
    old, new = supervised_drive(Path("drives/old.mcap")), supervised_drive(Path("drives/new.mcap"), 2000)
    idle = supervised_drive(Path("drives/idle.mcap"), 3000, taken=range(0))
    assert call(main, "continue", "first", "--name", "second", "--takeovers", old, "--epochs", "1") == 0
    again = (
        "continue",
        "second",
        "--name",
        "third",
        "--epochs",
        "1",
        "--takeovers",
        Path("drives/../drives/old.mcap"),
    )
    assert call(main, *again) == 1
    assert "old.mcap: runs/second has already learned from it; to train longer" in capsys.readouterr().err
    assert call(main, *again, idle) == 1
    assert f"{idle}: no frame of a takeover" in capsys.readouterr().err
    assert not Path("index-third").exists()
    assert call(main, *again, new) == 0
    assert "old.mcap: runs/second has already learned from it\n" in capsys.readouterr().err
    assert set(sessions_in("index-third")) == {"lake", "old", "new"}


def test_a_drive_is_named_as_other_commands_name_it(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A mistyped drive is not left out of the training."""
    assert call(main, "--name", "first", "--on", "lake", *SMALL) == 0
    drive = supervised_drive(Path("drives/run.mcap"))
    again = ("continue", "first", "--name", "second", "--epochs", "1", "--takeovers")
    for wrong in ("rum", "drives/rum.mcap"):
        assert call(main, *again, wrong, drive) == 1
        assert "bc-train continue: drives/rum.mcap: no such log" in capsys.readouterr().err
    assert not Path("index-second").exists()
    assert call(main, *again, "run") == 0
    assert set(sessions_in("index-second")) == {"lake", "run"}


def test_a_drive_without_a_takeover_teaches_nothing(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "--name", "first", "--on", "lake", *SMALL) == 0
    drive = supervised_drive(Path("drives/a.mcap"), taken=range(0))
    assert call(main, "continue", "first", "--name", "second", "--takeovers", drive) == 1
    assert f"{drive}: no frame of a takeover to learn from" in capsys.readouterr().err
    assert not Path("index-second").exists()
    assert not Path("runs/second").exists()


def test_an_index_that_is_there_is_not_written_over(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("index-first").mkdir()
    assert call(main, "--name", "first", "--on", "lake", *SMALL) == 1
    assert "index-first exists already, perhaps of a stopped training: remove it, or" in one_line_in(capsys)
    assert not Path("runs/first").exists()
