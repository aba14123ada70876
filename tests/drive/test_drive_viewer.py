"""`bc-drive` shows the drive by itself where there is a display, and drives on whatever becomes of that."""

from __future__ import annotations

import shlex
import signal
import sys
from pathlib import Path

import pytest

from simulator.protocol.client import SimulatorClient
from simulator.protocol.replay import replay
from tests.helpers.driving import (
    PATIENT,
    Process,
    command,
    command_after,
    environment,
    road_jpeg,
    untrained_run,
    with_viewer,
)
from tests.helpers.logs import read_messages
from tests.helpers.waiting import wait_until

FRAMES = 20
# In the place of the real one, which would open a window: it tells how it was called, and stays.
STAND_IN = """
import sys, time
print("stand-in", *sys.argv[1:], file=sys.stderr, flush=True)
time.sleep(1000)
"""
FAILING = "raise SystemExit('viewer: no graphics')"


@pytest.fixture(scope="module")
def pilot_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return untrained_run(tmp_path_factory.mktemp("runs") / "first")


@pytest.fixture
def display(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes have a display."""
    with_a_display = {**environment(), "DISPLAY": ":77"}
    monkeypatch.setattr("tests.helpers.driving.environment", lambda: with_a_display)


def drive(process: Process) -> None:
    """Be a simulator that has driven `FRAMES` frames when this returns."""
    port = int(process.wait_for(r"is waiting for a simulator on 127\.0\.0\.1:(\d+)")[1])
    replay(SimulatorClient(port=port), [road_jpeg(i) for i in range(FRAMES)])


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="there is always a display there")
def test_without_a_display_the_command_that_shows_the_drive_is_said(pilot_run: Path, tmp_path: Path) -> None:
    log = tmp_path / "a drive.mcap"
    line = command_after(PATIENT, "bc-drive", pilot_run, "--log", log, "--port", 0)
    with Process(line) as process:
        printed = process.wait_for(r"^bc-drive: watch it with `(.*)`$")[1]
        drive(process)
        program, *arguments = shlex.split(printed)
        rrd = tmp_path / "a.rrd"
        with Process(command(program, *arguments, "--save", rrd)) as play:  # that very command
            wait_until(lambda: list(tmp_path.glob("a.rrd.*.part")))
            assert process.end() == 0
            assert play.join() == 0, play.stderr
    assert not any(line.startswith("viewer") for line in process.stderr)
    assert len(read_messages(log)["/camera/center"]) == FRAMES


@pytest.mark.usefixtures("display")
@pytest.mark.skipif(sys.platform == "win32", reason="no log is shown there while it grows")
@pytest.mark.parametrize("viewer", [(), ("--viewer", "off")])
def test_with_a_display_the_drive_is_shown_unless_that_is_turned_off(
    viewer: tuple[str, ...], pilot_run: Path, tmp_path: Path
) -> None:
    log = tmp_path / "run.mcap"
    line = command_after(
        [*PATIENT, with_viewer(STAND_IN)], "bc-drive", pilot_run, "--log", log, "--port", 0, *viewer
    )
    with Process(line) as process:
        if not viewer:
            assert process.wait_for(r"^stand-in (\S+) --follow$")[1].startswith(f"{log}.")
        drive(process)
        assert process.end() == 0
    assert not any("watch it" in line for line in process.stderr)
    assert any("stand-in" in line for line in process.stderr) is not bool(viewer)
    assert len(read_messages(log)["/camera/center"]) == FRAMES


@pytest.mark.usefixtures("display")
@pytest.mark.skipif(sys.platform == "win32", reason="no log is shown there while it grows")
def test_a_viewer_that_cannot_be_shown_costs_a_line_and_no_answer(pilot_run: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    line = command_after([*PATIENT, with_viewer(FAILING)], "bc-drive", pilot_run, "--log", log, "--port", 0)
    with Process(line) as process:
        process.wait_for("^viewer: no graphics$")
        drive(process)
        assert process.end(signal.SIGINT) == 0
    assert len(read_messages(log)["/camera/center"]) == FRAMES
