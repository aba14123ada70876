"""The examples do what their page says."""

from __future__ import annotations

from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

from drive import drive_session
from drive.config import DriveConfig
from drive.drive_server import DriveServer
from driving import DriveProcess, Process, command, untrained_run
from model import load_pilot
from own_simulator import MAX_DEG, Car
from recorder import Log
from recorder.log.session_car import Car as Settings
from recorder.log.session_car import max_steering_deg_of, named_car, stored_car
from recorder.server import in_flight
from recorder.topics import POSE
from repository import ROOT
from simulator import SimulatorClient, SimulatorTelemetry
from waiting import PATIENCE_S, wait_until

TELEMETRIES = 40
SETTINGS = ROOT / "examples" / "own_simulator.toml"


def test_an_example_is_short_and_linked_from_its_page() -> None:
    for example in sorted((ROOT / "examples").glob("*.py")):
        code = example.read_text(encoding="utf-8")
        assert code.count("\n") <= 60, example
        pages = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md"))
        assert f"\n[examples/{example.name}](../examples/{example.name})\n" in pages, (
            example
        )  # the site shows its code


def drive_car(port: int) -> Car:
    car = Car(TELEMETRIES)
    lock_step(port).run(car.next_telemetry)
    return car


def lock_step(port: int) -> SimulatorClient:
    return SimulatorClient(port=port, wait_s=PATIENCE_S, max_steering_deg=MAX_DEG, in_flight=1)


def test_ones_own_simulator_is_recorded(tmp_path: Path) -> None:
    path = tmp_path / "mine.mcap"
    flags = ("--port", 0, "--sessions", tmp_path, "--car", SETTINGS)
    with Process(command("bc-record", "listen", "mine", *flags)) as process:
        car = drive_car(int(process.wait_for(r"waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]))
        assert process.end() == 0
    with Log(path) as log:
        steering = log.vehicle()["steering"].to_pylist()
        assert stored_car(log) == named_car(str(SETTINGS))
        assert max_steering_deg_of(log) == MAX_DEG
        assert log.counts["/camera/center"] == log.counts["/vehicle"] == log.counts[POSE] == TELEMETRIES
    assert abs(steering[-1] - car.telemetry().steering) < 0.1  # 1 is its full lock, not Udacity's
    world = car.telemetry().world
    assert world is not None
    assert abs(world["offset"]) < 0.2  # its own driver keeps to the road


def test_ones_own_simulator_is_driven(tmp_path: Path) -> None:
    run = untrained_run(tmp_path / "run")
    with DriveProcess(run, tmp_path / "run.mcap", "--car", SETTINGS) as process:
        drive_car(process.wait_until_it_listens())
        assert process.end() == 0
    with Log(tmp_path / "run.mcap") as log:
        assert stored_car(log) == Settings(max_steering_deg=MAX_DEG, wheelbase_m=2.6)
        driven = log.vehicle()["steering"].to_pylist()
        sent = [command.steering for _, command in log.commands()]
        np.testing.assert_allclose(driven[1:], sent[:-1], atol=1e-4)  # each answer takes hold at once
        assert log.counts["/pilot/command"] == TELEMETRIES


def test_pauses_make_ones_own_simulator_act_no_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It pauses three times, until it is sent a steer that answers nothing: all the same, each row is steered by
    the answer to the one before."""
    monkeypatch.setattr(drive_session, "WATCHDOG_S", 0.3)
    for name in ("MIN_HOLD_S", "MAX_HOLD_S"):  # others may have the processor meanwhile
        monkeypatch.setattr(in_flight, name, PATIENCE_S)
    pilot, log = load_pilot(untrained_run(tmp_path / "run")), tmp_path / "run.mcap"
    car, over = Car(TELEMETRIES), Event()

    def next_telemetry(command: Any) -> SimulatorTelemetry | None:
        if car.left in (10, 20, 30):
            pushes = server.session.summary.pushes
            wait_until(lambda: server.session.summary.pushes > pushes)
        return car.next_telemetry(command)

    with DriveServer(pilot, DriveConfig(car=named_car(str(SETTINGS))), log, port=0) as server:
        serving = Thread(target=server.run, args=(over.is_set,))
        serving.start()
        lock_step(server.port).run(next_telemetry)
        over.set()
        serving.join(PATIENCE_S)
    with Log(log) as drive:
        vehicle = drive.vehicle()
        steering = dict(zip(vehicle["row"].to_pylist(), vehicle["steering"].to_pylist(), strict=True))
        commands = list(drive.commands())  # rows that were left unanswered have none
    driven = [steering[message.sequence] for message, _ in commands]
    sent = [command.steering for _, command in commands]
    assert {command.in_flight for _, command in commands} == {1}
    np.testing.assert_allclose(driven[1:], sent[:-1], atol=1e-4)
