"""The examples do what their page says."""

from __future__ import annotations

from pathlib import Path

from driving import DriveProcess, Process, command, untrained_run
from own_simulator import Car
from recorder import Log
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
    SimulatorClient(port=port, wait_s=PATIENCE_S).run(car.next_telemetry)
    return car


def test_ones_own_simulator_is_recorded(tmp_path: Path) -> None:
    path = tmp_path / "mine.mcap"
    flags = ("--listen", "--port", 0, "--idle", 0.3, "--sessions", tmp_path)
    with Process(command("bc-record", "mine", *flags)) as process:
        car = drive_car(int(process.wait_for(r"waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]))
        assert process.join() == 0
    with Log(path) as log:
        assert log.counts["/camera/center"] == log.counts["/vehicle"] == log.counts[POSE] == TELEMETRIES
    world = car.telemetry().world
    assert world is not None
    assert abs(world["offset"]) < 0.2  # its own driver keeps to the road


def test_ones_own_simulator_is_driven(tmp_path: Path) -> None:
    with DriveProcess(untrained_run(tmp_path / "run"), tmp_path / "run.mcap") as process:
        drive_car(process.wait_until_it_listens())
        assert process.end() == 0
    with Log(tmp_path / "run.mcap") as log:
        assert log.counts["/pilot/command"] == TELEMETRIES
