"""The session of one driven simulator: its driver, its log and its summary."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Final, Self

from common.errors import counted
from drive.at_wheel import AtWheel
from drive.config import DriveConfig
from drive.control.driver import Decision, Driver
from drive.log.drive_log import DriveLog
from drive.log.drive_summary import DriveSummary
from drive.log.summary_lines import LiveStatus
from model import Pilot
from recorder import LogWriter
from recorder.log.tags import Tag
from recorder.log.writer import close_with_tags
from recorder.server.in_flight import RunningClock
from recorder.server.telemetry_server import Answer, Steer
from recorder.teleop.pedals import WALKING_MPH
from recorder.topics import DRIVE_METADATA

WATCHDOG_S: Final = 1.0
"""The silence after which a command is sent: if all telemetry is lost, Udacity's simulator sends more only after a
command. The time grows by this value for each such command of the last minute, minus the messages left unanswered
for them. Otherwise, a simulator with longer steps would get a further command in each step."""

FORGET_S: Final = 60.0  # the time after which a command of the watchdog does not count any more

SILENT_S: Final = 0.2
"""The silence of a braking simulator after which the brake, and its release, are sent without telemetry."""

_NEUTRAL: Final = Steer(0.0, 0.0)


class DriveSession:
    """Answers one simulator, also when it connects again, and writes everything to one log.

    As a context manager, it finishes the log. An exception in its block ends the log as in `LogWriter`.
    """

    def __init__(
        self,
        pilot: Pilot,
        config: DriveConfig,
        writer: LogWriter,
        notify: Callable[[str], None] = lambda text: None,
        at_wheel: AtWheel | None = None,
    ) -> None:
        self._notify = notify
        self.writer = writer
        self.log = DriveLog(writer)
        self.summary = DriveSummary()
        self._status = LiveStatus(self.summary)
        self._pilot = pilot
        self._config = config
        self._at_wheel = at_wheel
        self._tags: list[Tag] = []  # of rows that a person rejected, who is at another session's wheel now
        self._driver = self._new_driver()
        self._metadata: dict[str, dict[str, str]] = {}
        self._last_steer = _NEUTRAL
        self._clock = RunningClock()
        self._last_telemetry_s = 0.0  # by `_clock`, as `_last_push_s`
        self._last_push_s = 0.0
        self._was_pushed = False
        self._unpaid = 0  # commands that answered no message, minus messages left unanswered for them
        self._is_stopping = self._was_braking = False
        self.is_connected = False
        self.rolling_reason = ""
        """The reason why the car may still roll at the end of a drive; empty if it stands."""
        self.is_at_rest = False
        """True when the car stands or, if its speed is unknown, when the brake has ended."""
        self.stop_notice = ""  # the notice of the braking; empty until the brake has been sent

    def connected(self) -> None:
        self._driver = self._new_driver()
        self._last_steer, self._unpaid = _NEUTRAL, 0
        self._note_telemetry()
        self.is_connected, self._is_stopping = True, False
        self.summary.connected()
        self.log.event("connected")

    def disconnected(self, reason: str) -> None:
        self.is_connected = False
        self.log.disconnected(reason)

    def telemetry(self, data: object, received_s: float, in_flight: int = 1) -> Answer:
        """The answer to a telemetry message. `in_flight` is the number of messages in flight, including this
        one."""
        self._note_telemetry()
        if data is None:  # a human holds a key
            self.rolling_reason = "a human drives it"
            if self._is_stopping:
                self.stop_notice = "a human drives the car: it cannot be braked"
            return Answer(None, self._record_manual)
        self.attend()
        decision = replace(self._driver.decide(data, received_s), in_flight=in_flight)
        if self._is_stopping:
            self._update_standstill(decision)
        self._last_steer = Steer(decision.steering, decision.throttle, decision.decimal_separator)
        puts_back = self._at_wheel is not None and self._at_wheel.puts_back()
        return Answer(
            replace(self._last_steer, puts_back=puts_back), lambda total_ms: self._record(decision, total_ms)
        )

    def unanswered(self, data: object, received_s: float) -> None:
        self._note_telemetry()
        self._unpaid = max(0, self._unpaid - 1)
        self.summary.unanswered += 1
        self.log.event("too many telemetries in flight: one is left unanswered")
        if data is not None:
            self.log.decision(self._driver.read(data), (time.perf_counter() - received_s) * 1e3)

    def first_command_sent(self) -> None:
        self.summary.pushes += 1
        self.log.event("no telemetry for a second after the connection: 0,0 was sent, to make the simulator begin")

    def watchdog_steer(self) -> Steer | None:
        """The command for a silent simulator, once for each silence; None if none is due."""
        is_due = self.is_connected and not self._was_pushed and self.silent_s >= WATCHDOG_S * (1 + self._unpaid)
        if not is_due:
            return None
        self._was_pushed, self._last_push_s = True, self._clock.seconds
        self._unpaid += 1
        self.summary.pushes += 1
        self.log.event("no telemetry for a second: sent a steer, to make the simulator go on", is_problem=True)
        steering, throttle, events = self._driver.go_on_without_telemetry()
        for text in events:
            self.log.event(text)
        self._report(events, is_problem=False)
        self._last_steer = replace(self._last_steer, steering=steering, throttle=throttle)
        return self._last_steer

    def brake_steer(self) -> Steer | None:
        """The brake, or its release, for a simulator that is stopping and silent; None if none is due."""
        if not (self.is_connected and self._is_stopping) or self.silent_s < SILENT_S:
            return None
        steering, throttle = self._driver.brake_without_telemetry()
        self.rolling_reason, self.is_at_rest = "its simulator is silent", throttle == 0.0
        self._report_braking(throttle < 0)
        if self._last_steer.throttle == throttle:
            return None
        self._last_steer = replace(self._last_steer, steering=steering, throttle=throttle)
        return self._last_steer

    def hand_wheel_to(self, other: DriveSession) -> None:
        """Let the person at this session's wheel drive the car of another one."""
        if self._at_wheel is not None:
            at_wheel, self._at_wheel = self._at_wheel, None
            self._tags += at_wheel.leave()
            other._at_wheel, other._driver.person = at_wheel, at_wheel.person
            text = f"the simulator has gone: the wheel is that of the other one, logged to {other.writer.path}"
            other._report([text], is_problem=True)

    def attend(self) -> None:
        """Carry out the requests of the page of the person at the wheel."""
        for text in self._at_wheel.attend() if self._at_wheel is not None else ():
            self.log.event(text)
            self._notify(text)

    def note_silence(self) -> None:
        if self._at_wheel is not None:
            self._at_wheel.wheel.note_silence(self.silent_s, is_connected=self.is_connected)

    @property
    def is_end_asked(self) -> bool:
        return self._at_wheel is not None and self._at_wheel.is_ended

    @property
    def silent_s(self) -> float:
        """Seconds since the last telemetry, without time in which this process was suspended."""
        return self._clock.tick() - self._last_telemetry_s

    def stop(self) -> None:
        self._driver.stop()
        self._is_stopping, self.is_at_rest = True, False
        self._was_braking, self.stop_notice = False, ""
        self.rolling_reason = "its simulator is silent"

    def final_command(self) -> Steer:
        """The last command, which the simulator keeps for ever."""
        return replace(_NEUTRAL, decimal_separator=self._last_steer.decimal_separator)

    def status(self, now_s: float) -> str:
        if self.is_connected or self.is_empty:
            return self._status.line(now_s)
        return f"the simulator has disconnected: waiting, with {counted(self.log.frames, 'frame')} so far"

    def end_notice(self) -> str:
        """The notice about a car that may still roll at the end of a drive; empty if it stands."""
        if self.is_at_rest and not self.rolling_reason:
            return ""
        text = f"the car may still roll: {self.rolling_reason}"
        self.log.event(text, is_problem=True)
        return text

    def add_metadata(self, record: str, values: dict[str, str]) -> None:
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
        if self._at_wheel is not None:
            self._tags += self._at_wheel.recording.tags
        if kind is None and self._tags:
            close_with_tags(self.writer, self._tags)
        self.writer.__exit__(kind)
        if kind is None and self._at_wheel is not None:
            self._at_wheel.end(self.writer.path, self.log.frames)
        if failure is not None:
            raise failure

    @property
    def is_empty(self) -> bool:
        """True if no telemetry has come."""
        return self.summary.telemetries == self.summary.unanswered == 0

    def _note_telemetry(self) -> None:
        self._last_telemetry_s, self._was_pushed = self._clock.tick(), False
        if self._last_telemetry_s - self._last_push_s >= FORGET_S:
            self._unpaid = 0

    def _new_driver(self) -> Driver:
        person = None if self._at_wheel is None else self._at_wheel.person
        return Driver(self._pilot, self._config, person=person)

    def _update_standstill(self, decision: Decision) -> None:
        speed_mph, is_braking = decision.speed_mph, decision.throttle < 0
        self._report_braking(is_braking)
        if speed_mph is None:
            self.rolling_reason = "its speed is unknown"
            self.is_at_rest = not is_braking
        else:
            self.is_at_rest = speed_mph <= WALKING_MPH
            self.rolling_reason = "" if self.is_at_rest else f"it goes {speed_mph:.1f} mph"

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
        for problem in () if decision.telemetry is None else decision.telemetry.side_problems:
            if not self.summary.side_problems[problem]:
                self._notify(f"a picture that cannot be used: {problem}")
        self.summary.decision(decision, total_ms)
        if self._at_wheel is not None:
            self._at_wheel.show(decision, self.log.frames - 1)
        self._report(decision.events, is_problem=bool(decision.problem))

    def _report(self, events: Iterable[str], *, is_problem: bool) -> None:
        """Print events: they explain why the car brakes, or who drives. The page shows them, too."""
        for text in events:
            self._notify(text)
            if self._at_wheel is not None:
                self._at_wheel.wheel.event(text, is_problem=is_problem)
