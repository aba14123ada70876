"""A silent simulator is sent a command that answers no telemetry; one that could not be heard is not silent."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drive.config import DriveConfig
from drive.drive_server import DriveServer
from drive.drive_session import FORGET_S, DriveSession
from drive.log.summary_lines import summary_lines
from model import load_pilot
from recorder import Log
from recorder.topics import DRIVE_METADATA
from tests.helpers.driving import untrained_run
from tests.helpers.logs import read_messages
from tests.helpers.serving import fields

TICK_S = 0.125


class Clock:
    """This computer's, as the test lets it go."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class Drive:
    """A drive on a clock of the test's own."""

    def __init__(self, server: DriveServer, clock: Clock) -> None:
        self.server, self.clock = server, clock
        server.connected("a")
        self.tell()

    @property
    def session(self) -> DriveSession:
        return self.server.session

    def tell(self) -> None:
        self.server.telemetry("a", fields(0), time.perf_counter()).on_sent(1.0)

    def seconds_to_push(self) -> float:
        """The ticks until a command is sent, each on time."""
        began_s = self.clock.now_s
        while self.session.watchdog_steer() is None:
            self.clock.now_s += TICK_S
        return self.clock.now_s - began_s


@pytest.fixture
def drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Drive]:
    clock = Clock()
    monkeypatch.setattr(time, "monotonic", clock)
    log = tmp_path / "run.mcap"
    with DriveServer(load_pilot(untrained_run(tmp_path / "run")), DriveConfig(), log, port=0) as server:
        yield Drive(server, clock)


@pytest.mark.parametrize("silent_s", [0.0, 0.5])
def test_the_time_in_which_bc_drive_was_stopped_is_no_silence(drive: Drive, silent_s: float) -> None:
    """As a laptop that slept, Ctrl-Z and `fg`, an overloaded machine."""
    while drive.clock.now_s < 100 + silent_s:
        drive.clock.now_s += TICK_S
        assert drive.session.watchdog_steer() is None
    drive.clock.now_s += 1.5
    assert drive.session.watchdog_steer() is None
    assert 0.25 <= drive.seconds_to_push() + silent_s <= 1.0  # a simulator that is silent all the same


def test_a_simulator_whose_steps_take_longer_gets_no_command_in_each(drive: Drive) -> None:
    """Nothing was left unanswered for the first two: either they were needed, or its steps take so long."""
    assert drive.seconds_to_push() == 1.0
    drive.tell()
    assert drive.seconds_to_push() == 2.0
    drive.tell()
    assert drive.seconds_to_push() == 3.0
    for _ in range(int((FORGET_S + 1) / TICK_S)):
        drive.clock.now_s += TICK_S
        drive.tell()
    assert drive.seconds_to_push() == 1.0


def test_a_pause_that_was_paid_back_delays_no_later_command(drive: Drive) -> None:
    for _ in range(3):
        assert drive.seconds_to_push() == 1.0
        drive.server.unanswered("a", fields(0), time.perf_counter())
        drive.tell()


def test_what_was_sent_unasked_and_left_unanswered_is_in_the_log(tmp_path: Path, drive: Drive) -> None:
    drive.server.first_command_sent("a")
    drive.seconds_to_push()
    drive.server.unanswered("a", fields(0), time.perf_counter())
    text = "\n".join(summary_lines(drive.session.summary))
    assert "silent for more than a second: 2 commands answered no telemetry" in text
    assert "too many telemetries were in flight: 1 telemetry got no answer" in text
    drive.server.__exit__(None, None, None)
    log = tmp_path / "run.mcap"
    messages = read_messages(log)
    assert [message.sequence for message, _ in messages["/camera/center"]] == [0, 1]
    assert [message.sequence for message, _ in messages["/vehicle"]] == [0, 1]
    assert [message.sequence for message, _ in messages["/pilot/command"]] == [0]
    events = [event.message for _, event in messages["/events"]]
    assert sum("0,0 was sent" in text for text in events) == 1
    assert sum(text.startswith("no telemetry for a second: sent a steer") for text in events) == 1
    assert sum("one is left unanswered" in text for text in events) == 1
    with Log(log) as whole:
        counts = whole.read_metadata(DRIVE_METADATA)
    assert (counts["pushes"], counts["unanswered"]) == ("2", "1")
