"""`bc-drive --takeover`, then `bc-train continue`: a network learns where an expert had to take over."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import operator
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from dataset import IndexConfig, build_index
from drive.cli import main as drive_main
from model import TrainConfig, train
from model.cli import main
from recorder import Log
from recorder.bc_pb2 import PilotCommand
from recorder.log.session_car import Car, stored_car
from simulator.protocol.client import ServerCommand, SimulatorClient, SimulatorMessage, SimulatorTelemetry
from tests.helpers.driving import Process, command, one_line_in, road_jpeg
from tests.helpers.logs import write_log
from tests.helpers.udacity import call

SETTINGS = IndexConfig(cameras=("center",), balance=False, flip=False, block_s=1.0, gap_s=0.0)
DRIVE = Path("takeovers.mcap")
LEARN = ("continue", "first", "--takeovers", DRIVE, "--name", "next", "--epochs", 1)


def a_session(path: Path, first: int, rows: int, car: Car | None = None) -> Path:
    """A session of so many of the drawn pictures, none of which another one may have."""
    steering = [0.3 * math.sin(row / 9) for row in range(rows)]
    return write_log(path, steering, lambda camera, row: road_jpeg(first + row), cameras=["center"], car=car)


def a_run(session: Path) -> None:
    """A network that has learnt next to nothing from the session."""
    build_index([session], Path("index"), SETTINGS)
    config = TrainConfig(network="small", epochs=1, batch=32, rate=1e-4)
    train(Path("index"), Path("runs/first"), config, show_progress=False)


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with the session lake and a run that has learnt from it."""
    folder = tmp_path_factory.mktemp("lake")
    with contextlib.chdir(folder):
        a_run(a_session(Path("sessions/lake.mcap"), 0, 60))
    return folder


@pytest.fixture
def project(lake: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A copy of it is the working folder."""
    shutil.copytree(lake, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)


def commands() -> list[PilotCommand]:
    with Log(DRIVE) as log:
        return [content for _, content in log.commands()]


def learnt_from() -> dict[str, list[dict[str, float]]]:
    """The samples of the next run by session."""
    samples = pq.read_table("index-next/samples.parquet").to_pylist()
    session_of = operator.itemgetter("session")
    return {name: list(rows) for name, rows in itertools.groupby(sorted(samples, key=session_of), session_of)}


@pytest.mark.usefixtures("project")
def test_the_next_run_learns_from_the_session_and_the_takeovers_alone(capsys: pytest.CaptureFixture[str]) -> None:
    where = ("--simulator", "random:3", "--laps", 0.04, "--speed", 20, "--viewer", "off")
    assert call(drive_main, "first", *where, "--takeover", "--log", DRIVE) == 0
    assert f"bc-train continue first --takeovers {DRIVE}" in capsys.readouterr().err
    driven = commands()
    expert = [command for command in driven if command.driver == PilotCommand.EXPERT]
    assert 0 < len(expert) < len(driven)
    assert all(command.steering == command.expert_steering for command in expert)
    assert call(main, *LEARN) == 0
    samples = learnt_from()
    assert set(samples) == {"lake", "takeovers"}
    assert all(driven[int(sample["row"])].driver == PilotCommand.EXPERT for sample in samples["takeovers"])
    config = json.loads(Path("runs/next/config.json").read_text())
    assert (config["data"]["settings"]["drives"], config["init"]["run"]) == ("takeovers", "first")


@pytest.mark.usefixtures("project")
def test_another_log_in_the_place_of_one_that_was_learnt_from_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("sessions/lake.mcap").unlink()
    a_session(Path("sessions/lake.mcap"), 200, 50)
    assert call(main, *LEARN) == 1
    assert "lake.mcap: changed since the run learned from it" in one_line_in(capsys)


TORCS = Car(max_steering_deg=23.0, wheelbase_m=2.6, speed_unit="km/h")


def drive_off_the_road(port: int) -> None:
    """A simulator of that car, 36 km/h fast; it is so far to the left that its expert steers to the right."""
    rows = iter(range(40))

    def next_telemetry(command: ServerCommand) -> SimulatorMessage:
        if command is None and client.steers == 0 and client.telemetries == 1:
            return "nothing"  # in lock step
        if (row := next(rows, None)) is None:
            return None
        world = {"time_s": row / 20, "offset": 0.95, "expert_steering": 0.5, "expert_throttle": 0.2}
        return SimulatorTelemetry(0.1, 0.2, 36.0, road_jpeg(100 + row), world)

    client = SimulatorClient(port=port, max_steering_deg=TORCS.max_steering_deg)
    client.run(next_telemetry)


def test_takeovers_of_another_car_in_a_simulator_that_connects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    a_run(a_session(Path("sessions/torcs.mcap"), 0, 60, TORCS))
    drive = ("first", "--port", 0, "--takeover", "expert", "--log", DRIVE, "--viewer", "off")
    with Process(command("bc-drive", *drive), tmp_path) as process:
        drive_off_the_road(int(process.wait_for(r"waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]))
        assert process.end() == 0, process.stderr
    with Log(DRIVE) as log:
        assert stored_car(log) == TORCS
        assert log.vehicle()["steering"].to_pylist() == pytest.approx([0.1] * 40)
        assert log.vehicle()["speed_mph"].to_pylist() == pytest.approx([22.369] * 40, abs=1e-3)
    assert call(main, *LEARN) == 0
    learnt = json.loads(Path("runs/next/config.json").read_text())
    assert {log["max_steering_deg"] for log in learnt["data"]["logs"].values()} == {23.0}
    assert {abs(sample["label"]) for sample in learnt_from()["takeovers"]} == {0.5}
