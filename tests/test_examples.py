"""The examples do what their page says."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from driving import DriveProcess, Process, command, untrained_run
from own_simulator import MAX_DEG, Car
from recorder import Log
from recorder.log.session_car import car_of
from recorder.log.topics import POSE
from repository import ROOT
from simulator import SimulatorClient
from waiting import PATIENCE_S

TELEMETRIES = 40


def test_an_example_is_short_and_stands_on_its_page() -> None:
    for example in sorted((ROOT / "examples").glob("*.py")):
        code = example.read_text(encoding="utf-8")
        assert code.count("\n") <= 60, example
        pages = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md"))
        assert f"```python\n{code}```\n" in pages, example


def drive_car(port: int) -> Car:
    car = Car(TELEMETRIES)
    SimulatorClient(port=port, wait_s=PATIENCE_S, max_steering_deg=MAX_DEG).run(car.next_telemetry)
    return car


def test_ones_own_simulator_is_recorded(tmp_path: Path) -> None:
    path = tmp_path / "mine.mcap"
    settings = ROOT / "examples" / "own_simulator.toml"
    flags = ("--listen", "--port", 0, "--sessions", tmp_path, "--car", settings)
    with Process(command("bc-record", "mine", *flags)) as process:
        car = drive_car(int(process.wait_for(r"waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]))
        assert process.end() == 0
    with Log(path) as log:
        steering = log.vehicle()["steering"].to_pylist()
        assert car_of(log).max_steering_deg == MAX_DEG
        assert car_of(log).bonnet == {}
        assert log.counts["/camera/center"] == log.counts["/vehicle"] == log.counts[POSE] == TELEMETRIES
    assert abs(steering[-1] - car.telemetry().steering) < 0.1  # 1 is its full lock, not Udacity's
    world = car.telemetry().world
    assert world is not None
    assert abs(world["offset"]) < 0.2  # its own driver keeps to the road


def test_ones_own_simulator_is_driven(tmp_path: Path) -> None:
    run, settings = untrained_run(tmp_path / "run"), ROOT / "examples" / "own_simulator.toml"
    with DriveProcess(run, tmp_path / "run.mcap", "--car", settings) as process:
        drive_car(process.wait_until_it_listens())
        assert process.end() == 0
    with Log(tmp_path / "run.mcap") as log:
        assert car_of(log).wheelbase_m == 2.6
        driven = log.vehicle()["steering"].to_pylist()
        sent = [command.steering for _, command in log.commands()]
        np.testing.assert_allclose(driven[2:], sent[:-2], atol=1e-4)  # what was answered is how it is steered
        assert log.counts["/pilot/command"] == TELEMETRIES
