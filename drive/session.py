"""One simulator that is driven: its driver, its log, and what is said of the drive at its end."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Final, Self

from drive.braking import WALKING_MPH
from drive.config import DriveConfig
from drive.driver import Decision, Driver
from drive.log import DriveLog
from drive.summary import DriveSummary
from model import Pilot
from recorder import LogWriter
from recorder.telemetry_server import Answer, Steer
from recorder.topics import DRIVE_METADATA

WATCHDOG_S: Final = 1.0
"""The real simulator tells nothing more once all its telemetries are lost; a steer makes it go on."""


class DriveSession:
    """Answers one simulator, also when it comes back, and writes everything to one log.

    As a context manager it finishes the log. What is raised in its block ends that as `LogWriter` does.
    """

    def __init__(
        self, pilot: Pilot, config: DriveConfig, writer: LogWriter, say: Callable[[str], None] = lambda text: None
    ) -> None:
        self._say = say
        self.writer = writer
        self.log = DriveLog(writer)
        self.summary = DriveSummary()
        self._pilot = pilot
        self._config = config
        self._driver = Driver(pilot, config)
        self._notes: dict[str, dict[str, str]] = {}
        self._last_steer: Steer | None = None
        self._last_telemetry_s = time.monotonic()
        self._is_pushed = False
        self._is_stopping = False
        self.is_connected = False
        self.stands = False
        """Whether the car has been braked to a stand."""

    def connected(self) -> None:
        self._driver = Driver(self._pilot, self._config)
        self._last_steer, self._last_telemetry_s, self._is_pushed = None, time.monotonic(), False
        self.is_connected, self.stands = True, False
        self.summary.connected()
        self.log.event("connected")

    def disconnected(self, reason: str) -> None:
        self.is_connected = False
        self.log.event(f"disconnected: {reason}")

    def telemetry(self, data: object, received_s: float) -> Answer:
        self._last_telemetry_s, self._is_pushed = time.monotonic(), False
        if data is None:  # a human holds a key
            return Answer(None, self._note_manual)
        decision = self._driver.decide(data, received_s)
        if self._is_stopping:
            decision = self._braked(decision)
        self._last_steer = Steer(decision.steering, decision.throttle, decision.decimal_comma)
        return Answer(self._last_steer, lambda total_ms: self._note(decision, total_ms))

    def push(self) -> Steer | None:
        """What to send unasked, once for each time that the simulator has fallen silent."""
        is_due = self.is_connected and not self._is_pushed and self.silent_s >= WATCHDOG_S
        if not is_due:
            return None
        self._is_pushed = True
        self.log.event("no telemetry for a second: sent a steer, to make the simulator go on", is_problem=True)
        return self._last_steer or Steer(0.0, 0.0, decimal_comma=False)

    @property
    def silent_s(self) -> float:
        """Seconds since the last telemetry."""
        return time.monotonic() - self._last_telemetry_s

    def stop(self) -> None:
        """From now on it is braked to a stand."""
        self._is_stopping = True

    def rest(self) -> Steer:
        """The last command: the simulator's car keeps it for ever."""
        return Steer(0.0, 0.0, self._last_steer is not None and self._last_steer.decimal_comma)

    def note(self, record: str, values: dict[str, str]) -> None:
        """A metadata record to be written at the log's end."""
        self._notes[record] = values

    def __enter__(self) -> Self:
        self.writer.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.log.close()
        failure = None if error is not None else self.log.failure
        if failure is not None:
            kind, error = type(failure), failure
        elif self.log.failure is None:
            if self.is_empty:
                self.writer.discard()
                return
            self.summary.dropped_pictures = self.log.dropped_pictures
            self.summary.dropped_rows = self.log.dropped_rows
            self.note(DRIVE_METADATA, self.summary.as_metadata())
            for record, values in self._notes.items():
                self.writer.add_metadata(record, values)
        self.writer.__exit__(kind, error, trace)
        if failure is not None:
            raise failure

    @property
    def is_empty(self) -> bool:
        """Whether nothing was told that could be driven on or written down."""
        return self.summary.telemetries == 0

    def _braked(self, decision: Decision) -> Decision:
        told = decision.telemetry
        self.stands = told is not None and told.speed_mph <= WALKING_MPH
        return replace(decision, throttle=0.0 if self.stands or told is None else -1.0)

    def _note_manual(self, total_ms: float) -> None:
        self.log.manual(total_ms)
        self.summary.manual(total_ms)

    def _note(self, decision: Decision, total_ms: float) -> None:
        self.log.decision(decision, total_ms)
        self.summary.decision(decision, total_ms)
        for text in decision.events:  # a car that brakes by itself, or is taken over, must not be a riddle
            self._say(text)
