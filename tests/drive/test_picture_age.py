"""Pictures are answered as soon after pauses of the simulator, and stops of bc-drive, as before them."""

from __future__ import annotations

import contextlib
import json
import signal
import statistics
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import aged_simulator
from driving import Process, command_after, untrained_run
from recorder import Log
from recorder.topics import DRIVE_METADATA
from repository import ROOT

TIMES = 20
PAUSE_S, STOP_S, BETWEEN_S = 2.0, 1.5, 1.0


class Pair:
    """`bc-drive` and a simulator that it drives."""

    def __init__(self, drive: Process, simulator: Process, log: Path, end: Path) -> None:
        self.drive, self.simulator, self.log, self._end = drive, simulator, log, end

    def ages_ms(self) -> list[float]:
        """Of all pictures that were answered; ends both."""
        self._end.touch()
        assert self.simulator.join() == 0
        assert self.drive.end() == 0
        ages: list[float] = json.loads(self.simulator.stdout)
        return ages


@contextlib.contextmanager
def a_pair(folder: Path, in_flight: int) -> Iterator[Pair]:
    folder.mkdir()
    log, end = folder / "run.mcap", folder / "end"
    line = command_after(
        aged_simulator.ANSWERS_BRIGHTNESS,
        "bc-drive",
        untrained_run(folder / "run"),
        "--log",
        log,
        "--port",
        0,
        "--viewer",
        "off",
    )
    with Process(line, loads_pytorch=True) as drive:
        port = drive.wait_for(r"is waiting for a simulator on 127\.0\.0\.1:(\d+)")[1]
        with Process([sys.executable, aged_simulator.__file__, port, str(in_flight), str(end)], ROOT) as simulator:
            yield Pair(drive, simulator, log, end)


def interrupt(process: Process, seconds: float) -> None:
    process.popen.send_signal(signal.SIGSTOP)
    time.sleep(seconds)
    process.popen.send_signal(signal.SIGCONT)
    time.sleep(BETWEEN_S)


@pytest.mark.long  # each rule: tests/recorder/test_in_flight.py
@pytest.mark.skipif(sys.platform == "win32", reason="processes cannot be stopped there")
@pytest.mark.parametrize("in_flight", [1, 2])
def test_pauses_and_stops_make_no_picture_older(tmp_path: Path, in_flight: int) -> None:
    """A pair without any runs at the same time."""
    with a_pair(tmp_path / "pair", in_flight) as pair, a_pair(tmp_path / "control", in_flight) as control:
        for _ in range(TIMES):
            interrupt(pair.simulator, PAUSE_S)
        for _ in range(TIMES):
            interrupt(pair.drive, STOP_S)
        ages_ms, control_ms = pair.ages_ms(), control.ages_ms()
    assert statistics.median(ages_ms) == pytest.approx(statistics.median(control_ms), rel=0.1)
    with Log(pair.log) as log:
        counts = log.read_metadata(DRIVE_METADATA)
    assert counts["pushes"] == counts["unanswered"] == str(TIMES)
