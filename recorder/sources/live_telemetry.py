"""Records the telemetry of connected simulators in a log."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

from common import Skipped, UserError
from common.errors import counted
from common.interrupts import stop_signals
from common.location import shown_address
from common.output import print_message
from common.progress import StatusLine
from common.streams import never_wait
from recorder.errors import RecordingError
from recorder.log.log_time import LogClock
from recorder.log.meant_gaps import (
    DISCONNECTED,
    HUMAN_DRIVES,
    HUMAN_HAS_STOPPED,
    BadTelemetry,
    HumanDriving,
    MeantGap,
)
from recorder.log.session_car import UDACITY, Car, metadata_of
from recorder.log.writer import EventLevel, LogWriter, close_with_tags, log_beside
from recorder.server.locale_numbers import POINT
from recorder.server.telemetry import (
    Telemetry,
    TelemetryError,
    check_whole_picture,
    parse_telemetry,
    write_telemetry,
)
from recorder.server.telemetry_server import NO_TELEMETRY_S, Answer, Steer, TelemetryServer
from recorder.server.world import WorldNotices
from recorder.sources.imported_rows import Imported
from recorder.sources.person_of_telemetry import PersonOfTelemetry
from recorder.sources.settings import ListenSettings
from recorder.teleop.frame_state import hello
from recorder.teleop.wheel import Wheel
from recorder.topics import PERSON_METADATA, Device

MAX_ROW_S = 0.2  # between two rows of a driven simulator; longer times were not recorded
RATE_S = 1.0  # the shown rows a second are measured over this time


def listen_for_telemetry(
    log: Path, settings: ListenSettings, *, overwrite: bool = False, person: PersonOfTelemetry | None = None
) -> Imported:
    """Record the telemetry of Socket.IO clients to `log`. The answer to every telemetry is `manual`, which asks
    for the next one, or the command of a `person`, who also chooses what is recorded.

    A second simulator at the same time has its own log next to `log`, which a notice names. A person drives only
    one simulator; others are not recorded.

    Ends on Ctrl-C or `kill`, or the settings' `idle_s` after the last telemetry. In other threads than the main
    thread, signals do not arrive.

    Raises RecordingError if no usable telemetry came, ListenError if the port is taken, UserError if `log` exists
    and `overwrite` is off, or if the disk fails.
    """
    never_wait()
    with stop_signals() as stopped, contextlib.ExitStack() as writing:
        with StatusLine() as status:
            listener = _Listener(log, settings.car, person, status, writing, overwrite=overwrite)
            first_command: Steer | Literal["manual"] = "manual" if person is None else Steer(0.0, 0.0)
            server = TelemetryServer(
                listener, host=settings.host, port=settings.port, notify=listener.warn, first_command=first_command
            )
            listener.server = server

            def is_over() -> bool:
                is_idle = settings.idle_s is not None and listener.is_idle_for(settings.idle_s)
                is_ended = stopped.is_set() or is_idle
                if person is None:
                    return is_ended
                return (is_ended or person.is_ended) and person.is_at_rest()

            listener.show(f"waiting for a simulator on {shown_address(settings.host, server.port)}")
            if settings.on_started is not None:
                settings.on_started(listener.sessions[0].writer.part)
            server.run(until=is_over)
        for session in listener.sessions:
            session.finish()
        recorded = [session for session in listener.sessions if session.rows]
        if not recorded:
            raise RecordingError(f"{log}: {listener.why_nothing()}")
        if person is not None:
            recorded[0].writer.add_metadata(PERSON_METADATA, {"hold_mph": f"{person.hold_mph:g}"})
            close_with_tags(recorded[0].writer, person.recording.tags)
    first, *others = [
        Imported(session.writer.path, session.rows, session.pictures, Skipped(), session.writer.notices)
        for session in recorded
    ]
    return replace(first, skipped=listener.skipped, others=others)


def listen_at_the_wheel(
    settings: ListenSettings,
    log: Path,
    hold_mph: float,
    *,
    overwrite: bool = False,
    on_wheel: Callable[[Wheel], object] | None = None,
) -> Imported:
    """Record a person's drive in a simulator that connects to `log`, until the page, Ctrl-C or silence ends it.

    `hold_mph`: the speed that the page offers to hold. `on_wheel` gets the wheel as soon as pages can connect.
    Raises as `listen_for_telemetry`.
    """
    about = hello("listen", log, hold_mph=hold_mph)
    with Wheel(f"{log.stem}, a simulator that connects", log, about) as wheel:
        if on_wheel is not None:
            on_wheel(wheel)
        person = PersonOfTelemetry(wheel, hold_mph)
        ended = {"log": str(log), "takeovers": []}
        try:
            done = listen_for_telemetry(log, settings, overwrite=overwrite, person=person)
        except RecordingError:
            wheel.end(ended | {"rows": 0, "why": f"{person.why}: nothing was recorded"})
            raise
        wheel.end(ended | {"rows": done.rows, "why": person.why})
        return done


class _Listener:
    """Gives each simulator a session with its own log. After a disconnection, a session takes the next one."""

    server: TelemetryServer

    def __init__(
        self,
        log: Path,
        car: Car | None,
        person: PersonOfTelemetry | None,
        status: StatusLine,
        writing: contextlib.ExitStack,
        *,
        overwrite: bool,
    ) -> None:
        """`writing` closes the logs. Raises UserError if `log` exists and `overwrite` is off."""
        self._log = log
        self._car = car
        self._person = person
        self._status = status
        self._writing = writing
        self._recorded: dict[str, _Session] = {}  # by connection
        self._notified: set[str] = set()
        self._connections = 0
        self._first_connected_s: float | None = None  # until the first telemetry, or the notice that none comes
        self._text = ""
        self._last_s: float | None = None  # of a telemetry
        self.skipped = Skipped()
        self.sessions: list[_Session] = []
        self._open(log, overwrite=overwrite)

    def connected(self, sid: str) -> None:
        self._connections += 1
        if self._connections == 1:
            self._first_connected_s = time.monotonic()
            self.show("connected, waiting for telemetry")

    def disconnected(self, sid: str, reason: str) -> None:
        if (session := self._recorded.pop(sid, None)) is not None:
            session.disconnected(reason)

    def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
        self._last_s = time.monotonic()
        session = self._session_of(sid)
        return Answer(None, lambda _: None) if session is None else session.telemetry(data)

    def unanswered(self, sid: str, data: object, received_s: float) -> None:
        self._last_s = time.monotonic()
        if (session := self._session_of(sid)) is not None:
            session.unanswered(data, received_s)

    def first_command_sent(self, sid: str) -> None:
        if (session := self._session_of(sid)) is not None:
            session.first_command_sent()

    def final_command(self, sid: str) -> Steer | None:
        session = self._recorded.get(sid)
        return None if self._person is None or session is None else Steer(0.0, 0.0, session.separator)

    def tick(self) -> None:
        if self._person is not None:
            self._attend(self._person)
        for session in self.sessions:
            session.tick()
        if self._last_s is not None:
            self._first_connected_s = None
            self._text = next(iter(self._recorded.values()), self.sessions[0]).status()
        elif self._first_connected_s is not None and time.monotonic() - self._first_connected_s >= NO_TELEMETRY_S:
            self._first_connected_s = None
            self.show("connected, but no telemetry comes: choose Autonomous Mode in the simulator")
        self._status.show(self._text)

    def warn(self, text: str) -> None:
        """Report a client that is not a simulator, or one that is not recorded."""
        self.sessions[0].warn(text)

    def show(self, text: str) -> None:
        self._text = text
        self._status.show_or_print(text)

    def is_idle_for(self, idle_s: float) -> bool:
        """True if the last telemetry came at least `idle_s` ago; False before the first."""
        return self._last_s is not None and time.monotonic() - self._last_s >= idle_s

    def why_nothing(self) -> str:
        if self._person is not None and self._last_s is not None:
            return "nothing was recorded: begin to record on the page, and drive"
        if self.skipped:
            return f"nothing was recorded{self.skipped.error_suffix()}"
        if self._last_s is not None:
            return (
                "nothing was recorded: the simulator sends nothing while its keys are held; drive in its training"
                " mode and follow that by `bc-import FOLDER NAME --watch`"
            )
        if self._connections:
            return "nothing was recorded: a client connected, but sent no telemetry; start its autonomous mode"
        return "nothing was recorded: no simulator connected; start its autonomous mode while this waits for it"

    def _attend(self, person: PersonOfTelemetry) -> None:
        self.sessions[0].handle_requests(person)
        sid = next(iter(self._recorded), None)
        person.note_silence(is_connected=sid is not None)
        if sid is not None and not self.server.has_unread(sid):
            steer = person.brake_if_silent(self._recorded[sid].separator)
            if steer is not None:
                self.server.push(sid, steer)

    def _session_of(self, sid: str) -> _Session | None:
        """The session of a client that sends telemetry; None if it is not recorded."""
        if sid in self._recorded:
            return self._recorded[sid]
        if self._person is not None and self._recorded:
            self._warn_once(
                "a second simulator is not driven or recorded, because a person has one wheel: close it"
            )
            return None
        free = [session for session in self.sessions if session not in self._recorded.values()]
        try:
            taken = {session.writer.path for session in self.sessions}
            session = free[0] if free else self._open(log_beside(self._log, taken))
        except UserError as error:  # the other simulators continue
            self._warn_once(f"a second simulator is not recorded: {error}")
            return None
        self._recorded[sid] = session
        session.connected()
        return session

    def _open(self, log: Path, *, overwrite: bool = False) -> _Session:
        driver = {} if self._person is None else {"driver": "human"}
        metadata = {"source": "telemetry", **driver, **metadata_of(self._car)}
        writer = self._writing.enter_context(LogWriter(log, metadata, overwrite=overwrite, live=True))
        session = _Session(writer, self._status, self._car or UDACITY, self.skipped, self._person)
        if self.sessions:
            session.warn(
                f"a second simulator has connected: it is recorded in {log}; close one of them if you did not want"
                " that"
            )
        self.sessions.append(session)
        return session

    def _warn_once(self, text: str) -> None:
        if text not in self._notified:
            self._notified.add(text)
            self.warn(text)


class _Session:
    """Writes one simulator's telemetry to a log. Rows are numbered from 0, and their times ascend."""

    def __init__(
        self,
        writer: LogWriter,
        status: StatusLine,
        car: Car,
        skipped: Skipped,
        person: PersonOfTelemetry | None = None,
    ) -> None:
        self.writer = writer
        self._status = status
        self._car = car
        self._skipped = skipped
        self._person = person
        self._last_row_ns = 0
        self._telemetries = 0
        self._is_human = False  # a human drives
        self._human_driving = HumanDriving()
        self._clock = LogClock()
        self._world_notices = WorldNotices()
        self._separator: str | None = None  # of decimals, if known
        self._rate_from = (time.monotonic(), 0)
        self._rate = 0.0
        self.rows = self.pictures = 0
        self._bad = BadTelemetry()

    @property
    def separator(self) -> str:
        return self._separator or POINT

    def connected(self) -> None:
        self._event(time.perf_counter_ns(), "connected")

    def disconnected(self, reason: str) -> None:
        self._separator, self._is_human = None, False
        self._human_driving.end(self._event(time.perf_counter_ns(), f"{DISCONNECTED}{reason}"))
        if self._person is not None:  # the simulator that remains may drive at once
            self._clock.end_drive()
            self._person.wait_for_touch()

    def telemetry(self, data: object) -> Answer:
        received_ns = time.perf_counter_ns()
        person = self._person
        if person is None or data is None:
            return Answer(None, lambda _: self._note(received_ns, self._parsed(data)))
        parsed = self._parsed(data)
        self.handle_requests(person)
        device, brake = person.control.device, person.brake  # in force when this picture was taken
        speed_mph = None if parsed is None else parsed.speed_mph
        command = person.command(
            parsed if isinstance(parsed, Telemetry) else None,
            math.nan if speed_mph is None else speed_mph,
            self.separator,
        )
        is_taken = person.takes_row()
        return Answer(command, lambda _: self._note(received_ns, parsed, device, brake, is_taken=is_taken))

    def unanswered(self, data: object, received_s: float) -> None:
        received_ns = round(received_s * 1e9)
        self._event(received_ns, "too many telemetries in flight: one is left unanswered")
        device, brake = (None, 0.0) if self._person is None else (self._person.control.device, self._person.brake)
        is_taken = self._person is None or self._person.takes_row()
        self._note(received_ns, self._parsed(data), device, brake, is_taken=is_taken)

    def first_command_sent(self) -> None:
        sent = "manual" if self._person is None else "a command"
        text = f"no telemetry for a second after the connection: {sent} was sent, to make the simulator begin"
        self._event(time.perf_counter_ns(), text)

    def tick(self) -> None:
        self.writer.flush_if_due()
        now_s = time.monotonic()
        since_s, rows = self._rate_from
        if now_s - since_s >= RATE_S:
            self._rate = (self.rows - rows) / (now_s - since_s)
            self._rate_from = (now_s, self.rows)

    def status(self) -> str:
        return (
            f"{counted(self.rows, 'row')}, {counted(self.pictures, 'picture')},"
            f" {self.writer.bytes_written / 1e6:,.1f} MB, {self._rate:,.0f} rows/s,"
            f" {len(self._skipped):,} skipped"
        )

    def warn(self, text: str) -> None:
        """Report something unexpected."""
        self._event(time.perf_counter_ns(), text, "WARNING")
        self._status.show_or_print(text)

    def finish(self) -> None:
        """Write the last events, when nothing more will come. A log without rows is removed: it would be kept for
        its events."""
        for text in self._bad.remaining():
            self._event(time.perf_counter_ns(), text, "WARNING")
        if not self.rows:
            self.writer.discard()

    def handle_requests(self, person: PersonOfTelemetry) -> None:
        for text in person.attend():
            self._event(time.perf_counter_ns(), text)

    def _parsed(self, data: object) -> Telemetry | TelemetryError | None:
        """A telemetry with a whole picture, or the reason why it is unusable; None while a human holds a key."""
        if data is None:
            return None
        try:
            telemetry = parse_telemetry(data, self._separator, self._car)
            if telemetry.observed_separator is not None:
                self._separator = telemetry.observed_separator
            check_whole_picture(telemetry.picture)
        except TelemetryError as error:
            if error.decimal_separator is not None:
                self._separator = error.decimal_separator
            return error
        return telemetry

    def _note(
        self,
        received_ns: int,
        telemetry: Telemetry | TelemetryError | None,
        device: Device | None = None,
        brake: float = 0.0,
        *,
        is_taken: bool = True,
    ) -> None:
        """Write a telemetry to the log, if it `is_taken`."""
        self._telemetries += 1
        if telemetry is None:
            if not self._is_human:
                self._human_driving.begin(self._event(received_ns, HUMAN_DRIVES))
            self._is_human = True
            return
        if isinstance(telemetry, TelemetryError):
            self._note_unusable("telemetries", received_ns, telemetry.kind, str(telemetry))
            return
        time_ns = self._clock.row(received_ns, None if telemetry.world is None else telemetry.world.time_s)
        for text in self._world_notices.new_notices(telemetry.world_problems, clock_stands=self._clock.stands):
            self.warn(text)
        if not is_taken:
            return
        gap = self._gap_before(time_ns)
        left_out_s = self._human_driving.take_s() + (gap.seconds if gap is not None else 0.0)
        write_telemetry(self.writer, time_ns, self.rows, telemetry, device, brake=brake, not_recorded_s=left_out_s)
        self.pictures += 1 + len(telemetry.side_pictures)
        for problem in telemetry.side_problems:
            self._note_unusable("pictures", received_ns, problem, problem)
        if gap is not None:
            self.writer.event(time_ns, str(gap), name="recorder")
        if self._person is not None:
            self._person.has_row(time_ns)
            self._last_row_ns = time_ns
        self.rows += 1

    def _gap_before(self, time_ns: int) -> MeantGap | None:
        """The person's pause before a row, if there was one. A row also ends a human's driving."""
        if self._is_human:
            self._is_human = False
            self._human_driving.end(time_ns)
            self.writer.event(time_ns, HUMAN_HAS_STOPPED, "INFO", "recorder")
        why = "" if self._person is None else self._person.recording.gap_why
        gap_s = (time_ns - self._last_row_ns) / 1e9 - MAX_ROW_S
        return MeantGap(gap_s, why) if self.rows and why and gap_s > 0 else None

    def _note_unusable(self, noun: str, received_ns: int, kind: str, reason: str) -> None:
        """Note an unusable telemetry, or an unusable picture of a side camera."""
        if kind not in self._bad.counts:
            print_message(f"{'telemetry' if noun == 'telemetries' else 'a picture'} that cannot be used: {reason}")
        self._skipped.add(f"{noun} that cannot be used ({kind})", f"number {self._telemetries}")
        if (text := self._bad.take(kind, reason)) is not None:
            self._event(received_ns, text, "WARNING")

    def _event(self, happened_ns: int, text: str, level: EventLevel = "INFO") -> int:
        time_ns = self._clock.event(happened_ns)
        self.writer.event(time_ns, text, level, "recorder")
        return time_ns
