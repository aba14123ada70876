"""The session of one simulator that is driven: its driver, its log and its summary."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final, Self

from common.errors import counted
from drive.config import DriveConfig
from drive.control.braking import WALKING_MPH
from drive.control.driver import Decision, Driver
from drive.log.drive_log import DriveLog
from drive.log.drive_summary import DriveSummary
from drive.log.live_status import LiveStatus
from model import Pilot
from recorder import LogWriter
from recorder.log.topics import DRIVE_METADATA
from recorder.server.telemetry_server import Answer, Steer

WATCHDOG_S: Final = 1.0
"""The silence after which a command is sent: the real simulator sends no more telemetry once all of it is lost,
until a command comes."""

SILENT_S: Final = 0.2
"""The silence of a braking simulator after which it is sent the brake, and its release, without telemetry."""

STABLE_S: Final = 10.0
"""A connection that lasts so long is stable."""

_NEUTRAL: Final = Steer(0.0, 0.0)


class DriveSession:
    """Answers one simulator, also when it comes back, and writes everything to one log.

    As a context manager it finishes the log; an exception in its block ends the log as it does in `LogWriter`.
    """

    def __init__(
        self,
        pilot: Pilot,
        config: DriveConfig,
        writer: LogWriter,
        notify: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._notify = notify
        self.writer = writer
        self.log = DriveLog(writer)
        self.summary = DriveSummary()
        self._status = LiveStatus(self.summary)
        self._pilot = pilot
        self._config = config
        self._driver = Driver(pilot, config)
        self._metadata: dict[str, dict[str, str]] = {}
        self._last_steer = _NEUTRAL
        self._last_telemetry_s = time.monotonic()
        self._was_pushed = False
        self._is_stopping = self._was_braking = False
        self.is_connected = False
        self._connected_s = 0.0
        self.connections = 0
        """The connections since the last stable one."""
        self.rolling_reason = ""
        """The reason why the car may not stand at the end of a drive; empty where it does."""
        self.is_at_rest = False
        """True once the car stands, or the brake has ended where its speed is unknown."""
        self.stop_notice = ""
        """The notice of how the car is stopped, once that has been sent."""

    def connected(self) -> None:
        self._driver = Driver(self._pilot, self._config, reported_size=self._driver.reported_size)
        self._last_steer, self._last_telemetry_s, self._was_pushed = _NEUTRAL, time.monotonic(), False
        self.is_connected, self._is_stopping = True, False
        self.connections += 1
        self._connected_s = time.monotonic()
        self.summary.connected()
        self.log.event("connected")

    def disconnected(self, reason: str) -> None:
        self.is_connected = False
        if time.monotonic() - self._connected_s >= STABLE_S:
            self.connections = 0
        self.log.event(f"disconnected: {reason}")

    def telemetry(self, data: object, received_s: float) -> Answer:
        self._last_telemetry_s, self._was_pushed = time.monotonic(), False
        if data is None:  # a human holds a key
            self.rolling_reason = "a human drives it"
            if self._is_stopping:
                self.stop_notice = "a human drives the car: it cannot be braked"
            return Answer(None, self._record_manual)
        decision = self._driver.decide(data, received_s)
        if self._is_stopping:
            self._update_standstill(decision)
        self._last_steer = Steer(decision.steering, decision.throttle, decision.decimal_separator)
        return Answer(self._last_steer, lambda total_ms: self._record(decision, total_ms))

    def watchdog_steer(self) -> Steer | None:
        """The command for a simulator that has fallen silent, once each time; None if none is due."""
        is_due = self.is_connected and not self._was_pushed and self.silent_s >= WATCHDOG_S
        if not is_due:
            return None
        self._was_pushed = True
        self.log.event("no telemetry for a second: sent a steer, to make the simulator go on", is_problem=True)
        # A simulator that stays silent keeps it for ever, and a brake would reverse the car in the end.
        return replace(self._last_steer, throttle=max(0.0, self._last_steer.throttle))

    def brake_steer(self) -> Steer | None:
        """The brake, or its release, for a simulator that is stopping and silent; None if none is due."""
        if not (self.is_connected and self._is_stopping) or self.silent_s < SILENT_S:
            return None
        steering, throttle = self._driver.brake_without_telemetry()
        self.rolling_reason, self.is_at_rest = "it sends nothing any more", throttle == 0.0
        self._report_braking(throttle < 0)
        if self._last_steer.throttle == throttle:
            return None
        self._last_steer = replace(self._last_steer, steering=steering, throttle=throttle)
        return self._last_steer

    @property
    def silent_s(self) -> float:
        """Seconds since the last telemetry."""
        return time.monotonic() - self._last_telemetry_s

    def stop(self) -> None:
        """From now on the car is braked to a stand."""
        self._driver.stop()
        self._is_stopping, self.is_at_rest = True, False
        self._was_braking, self.stop_notice = False, ""
        self.rolling_reason = "it sends nothing any more"

    def final_command(self) -> Steer:
        """The last command, which the simulator's car keeps for ever."""
        return replace(_NEUTRAL, decimal_separator=self._last_steer.decimal_separator)

    def status(self, now_s: float) -> str:
        """The status line of the drive."""
        if self.is_connected or self.is_empty:
            return self._status.line(now_s)
        return f"the simulator has gone: waiting, with {counted(self.log.frames, 'frame')} so far"

    def end_notice(self) -> str:
        """The notice about a car that may not stand at the end of a drive; empty where it does."""
        if self.is_at_rest and not self.rolling_reason:
            return ""
        text = f"the car may still roll: {self.rolling_reason}"
        self.log.event(text, is_problem=True)
        return text

    def add_metadata(self, record: str, values: dict[str, str]) -> None:
        """Add a metadata record, to be written at the log's end."""
        self._metadata[record] = values

    def __enter__(self) -> Self:
        self.writer.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.log.close()
        failure = None if kind is not None else self.log.failure
        if failure is not None:
            kind = type(failure)
        elif self.log.failure is None:
            if self.is_empty:
                self.writer.discard()
                return
            self.summary.dropped_pictures = self.log.dropped_pictures
            self.summary.dropped_rows = self.log.dropped_rows
            self.add_metadata(DRIVE_METADATA, self.summary.as_metadata())
            for record, values in self._metadata.items():
                self.writer.add_metadata(record, values)
        self.writer.__exit__(kind)
        if failure is not None:
            raise failure

    @property
    def is_empty(self) -> bool:
        """True if no telemetry came at all."""
        return self.summary.telemetries == 0

    def _update_standstill(self, decision: Decision) -> None:
        speed_mph, is_braking = decision.speed_mph, decision.throttle < 0
        self._report_braking(is_braking)
        if speed_mph is None:
            self.rolling_reason = "its speed is unknown"
            self.is_at_rest = not is_braking
        else:
            stands = speed_mph <= WALKING_MPH
            self.rolling_reason = "" if stands else f"it goes {speed_mph:.1f} mph"
            self.is_at_rest = stands

    def _report_braking(self, is_braking: bool) -> None:
        if is_braking and not self._was_braking:
            self._was_braking, self.stop_notice = True, "the car is braked to a stand"
            self.log.event(f"the drive ends: {self.stop_notice}")

    def _record_manual(self, total_ms: float) -> None:
        self.log.manual(total_ms)
        self.summary.manual(total_ms)

    def _record(self, decision: Decision, total_ms: float) -> None:
        self.log.decision(decision, total_ms)
        if decision.telemetry is None and not self.summary.bad[decision.kind]:
            self._notify(f"telemetry that cannot be used: {decision.problem}")
        self.summary.decision(decision, total_ms)
        for text in decision.events:  # a car that brakes by itself, or is taken over, must not be a riddle
            self._notify(text)
