"""One simulator that is driven: its driver, its log, and what is said of the drive at its end."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Final, Self

from common.errors import counted
from drive.config import DriveConfig
from drive.control.braking import WALKING_MPH
from drive.control.driver import Decision, Driver
from drive.log.drive_log import DriveLog
from drive.log.summary import DriveSummary
from model import Pilot
from recorder import LogWriter
from recorder.log.topics import DRIVE_METADATA
from recorder.server.telemetry_server import Answer, Steer

WATCHDOG_S: Final = 1.0
"""The real simulator tells nothing more once all its telemetries are lost; a steer makes it go on."""

SILENT_S: Final = 0.2
"""Whoever tells nothing for so long while it is braked is sent the brake, and its release, without being asked."""

STEADY_S: Final = 10.0
"""Whoever stays so long does not come and go."""

_REST: Final = Steer(0.0, 0.0)


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
        self._last_steer = _REST
        self._last_telemetry_s = time.monotonic()
        self._is_pushed = False
        self._is_stopping = self._was_braking = False
        self.is_connected = False
        self._connected_s = 0.0
        self.comings = 0
        """How often a simulator connected, since one last stayed."""
        self.rolls = ""
        """What speaks against it that the car stands, at the end of a drive; empty where it does."""
        self.is_braked = False
        """Whether it stands, or all was done that can be done without knowing its speed."""
        self.stopping = ""
        """How it is stopped, once that has been sent."""

    def connected(self) -> None:
        self._driver = Driver(self._pilot, self._config)
        self._last_steer, self._last_telemetry_s, self._is_pushed = _REST, time.monotonic(), False
        self.is_connected, self._is_stopping = True, False
        self.comings += 1
        self._connected_s = time.monotonic()
        self.summary.connected()
        self.log.event("connected")

    def disconnected(self, reason: str) -> None:
        self.is_connected = False
        if time.monotonic() - self._connected_s >= STEADY_S:
            self.comings = 0
        self.log.event(f"disconnected: {reason}")

    def telemetry(self, data: object, received_s: float) -> Answer:
        self._last_telemetry_s, self._is_pushed = time.monotonic(), False
        if data is None:  # a human holds a key
            self.rolls = "a human drives it"
            if self._is_stopping:
                self.stopping = "a human drives the car: it cannot be braked"
            return Answer(None, self._note_manual)
        decision = self._driver.decide(data, received_s)
        if self._is_stopping:
            self._see_whether_it_stands(decision)
        self._last_steer = Steer(decision.steering, decision.throttle, decision.decimal_separator)
        return Answer(self._last_steer, lambda total_ms: self._note(decision, total_ms))

    def push(self) -> Steer | None:
        """What to send unasked, once for each time that the simulator has fallen silent."""
        is_due = self.is_connected and not self._is_pushed and self.silent_s >= WATCHDOG_S
        if not is_due:
            return None
        self._is_pushed = True
        self.log.event("no telemetry for a second: sent a steer, to make the simulator go on", is_problem=True)
        # Whoever stays silent keeps it for ever, and a brake would reverse the car in the end.
        return replace(self._last_steer, throttle=max(0.0, self._last_steer.throttle))

    def push_brake(self) -> Steer | None:
        """What to send unasked to one that is stopping and tells nothing: the brake, and its release."""
        if not (self.is_connected and self._is_stopping) or self.silent_s < SILENT_S:
            return None
        steering, throttle = self._driver.unasked_brake()
        self.rolls, self.is_braked = "it tells nothing any more", throttle == 0.0
        self._note_braking(throttle < 0)
        if self._last_steer.throttle == throttle:
            return None
        self._last_steer = replace(self._last_steer, steering=steering, throttle=throttle)
        return self._last_steer

    @property
    def silent_s(self) -> float:
        """Seconds since the last telemetry."""
        return time.monotonic() - self._last_telemetry_s

    def stop(self) -> None:
        """From now on it is braked to a stand."""
        self._driver.stop()
        self._is_stopping, self.is_braked = True, False
        self._was_braking, self.stopping = False, ""
        self.rolls = "it tells nothing any more"

    def rest(self) -> Steer:
        """The last command: the simulator's car keeps it for ever."""
        return replace(_REST, decimal_separator=self._last_steer.decimal_separator)

    def status(self, now_s: float) -> str:
        """The live line."""
        if self.is_connected or self.is_empty:
            return self.summary.status(now_s)
        return f"the simulator has gone: waiting, with {counted(self.log.frames, 'frame')} so far"

    def end(self) -> str:
        """What to say of a car that may not stand at the end of a drive; empty where it does."""
        if self.is_braked and not self.rolls:
            return ""
        text = f"the car may still roll: {self.rolls}"
        self.log.event(text, is_problem=True)
        return text

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

    def _see_whether_it_stands(self, decision: Decision) -> None:
        speed_mph, is_braking = decision.speed_mph, decision.throttle < 0
        self._note_braking(is_braking)
        if speed_mph is None:
            self.rolls = "its speed is not told"
            self.is_braked = not is_braking
        else:
            stands = speed_mph <= WALKING_MPH
            self.rolls = "" if stands else f"it goes {speed_mph:.1f} mph"
            self.is_braked = stands

    def _note_braking(self, is_braking: bool) -> None:
        if is_braking and not self._was_braking:
            self._was_braking, self.stopping = True, "the car is braked to a stand"
            self.log.event(f"the drive ends: {self.stopping}")

    def _note_manual(self, total_ms: float) -> None:
        self.log.manual(total_ms)
        self.summary.manual(total_ms)

    def _note(self, decision: Decision, total_ms: float) -> None:
        self.log.decision(decision, total_ms)
        if decision.telemetry is None and not self.summary.bad[decision.kind]:
            self._say(f"telemetry that cannot be used: {decision.problem}")
        self.summary.decision(decision, total_ms)
        for text in decision.events:  # a car that brakes by itself, or is taken over, must not be a riddle
            self._say(text)
