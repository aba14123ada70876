"""Records the telemetry of connected simulators in a log."""

from __future__ import annotations

import contextlib
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from common import Skipped
from common.errors import counted
from common.interrupts import stop_signals
from common.output import print_message
from common.progress import StatusLine
from recorder.errors import RecordingError
from recorder.log.bad_telemetry import BadTelemetry
from recorder.log.log_time import LogClock
from recorder.log.meant_gaps import DISCONNECTED, HUMAN_DRIVES, HUMAN_HAS_STOPPED, HumanDriving, MeantGap
from recorder.log.session_car import UDACITY, Car, metadata_of
from recorder.log.writer import EventLevel, LogWriter
from recorder.rows.devices import Device
from recorder.server.locale_numbers import POINT
from recorder.server.telemetry import Telemetry, TelemetryError, check_whole_picture, parse_telemetry
from recorder.server.telemetry_row import write_telemetry
from recorder.server.telemetry_server import NO_TELEMETRY_S, Answer, Steer, TelemetryServer
from recorder.server.world import WorldNotices
from recorder.sources.imported_rows import Imported
from recorder.sources.settings import ListenSettings
from recorder.topics import PERSON_METADATA
from recorder.upkeep.derived_log import close_with_tags

if TYPE_CHECKING:
    from recorder.sources.person_of_telemetry import PersonOfTelemetry

MAX_ROW_S = 0.2  # between two rows of a driven simulator; longer times were not recorded
RATE_S = 1.0  # the shown rows a second are measured over this time


def listen_for_telemetry(
    log: Path, settings: ListenSettings, *, overwrite: bool = False, person: PersonOfTelemetry | None = None
) -> Imported:
    """Record the telemetry of Socket.IO clients to `log`. The answer to every telemetry is `manual`, which asks
    for the next one, or the command of a `person`, who also chooses what is recorded.

    Ends on Ctrl-C or `kill`, or the settings' `idle_s` after the last telemetry. In other threads than the main
    thread, signals do not arrive.

    Raises RecordingError if no usable telemetry came, ListenError if the port is taken, UserError if `log` exists
    and `overwrite` is off, or if the disk fails.
    """
    driver = {} if person is None else {"driver": "human"}
    metadata = {"source": "telemetry", **driver, **metadata_of(settings.car)}
    with stop_signals() as stopped, contextlib.ExitStack() as writing:
        writer = writing.enter_context(LogWriter(log, metadata, overwrite=overwrite, live=True))
        with StatusLine() as status:
            session = _Session(writer, status, settings.car or UDACITY, person)
            first_command: Steer | Literal["manual"] = "manual" if person is None else Steer(0.0, 0.0)
            server = TelemetryServer(
                session, host=settings.host, port=settings.port, notify=session.warn, first_command=first_command
            )

            def is_over() -> bool:
                is_idle = settings.idle_s is not None and session.is_idle_for(settings.idle_s)
                is_ended = stopped.is_set() or is_idle
                if person is None:
                    return is_ended
                return (is_ended or person.is_ended) and person.is_at_rest()

            session.show(f"waiting for a simulator on {settings.host}:{server.port}")
            if settings.on_started is not None:
                settings.on_started(writer.part)
            server.run(until=is_over)
        session.finish()
        if not session.rows:
            writing.pop_all()  # otherwise the live log would be kept for its events
            writer.discard()
            raise RecordingError(f"{log}: {session.why_nothing()}")
        if person is not None:
            writer.add_metadata(PERSON_METADATA, {"hold_mph": f"{person.hold_mph:g}"})
            close_with_tags(writer, person.recording.tags)
    return Imported(log, session.rows, session.pictures, session.skipped, writer.notices)


class _Session:
    """Writes telemetry to a log. Rows are numbered from 0, and their times ascend."""

    def __init__(
        self, writer: LogWriter, status: StatusLine, car: Car, person: PersonOfTelemetry | None = None
    ) -> None:
        self._car = car
        self._person = person
        self._last_row_ns = 0
        self._writer = writer
        self._status = status
        self._text = ""
        self._connections = 0
        self._first_connected_s: float | None = None  # until the first telemetry, or the notice that none comes
        self._telemetries = 0
        self._manuals = 0
        self._human: set[str] = set()  # the connections with a human driver
        self._human_driving = HumanDriving()
        self._clock = LogClock()
        self._world_notices = WorldNotices()
        self._separators: dict[str, str] = {}  # of decimals, by connection
        self._last_s = 0.0
        self._rate_from = (time.monotonic(), 0)
        self._rate = 0.0
        self.rows = self.pictures = 0
        self.skipped = Skipped()
        self._bad = BadTelemetry()

    def connected(self, sid: str) -> None:
        self._event(time.perf_counter_ns(), "connected")
        self._connections += 1
        if self._connections == 1:
            self._first_connected_s = time.monotonic()
            self.show("connected, waiting for telemetry")

    def disconnected(self, sid: str, reason: str) -> None:
        self._separators.pop(sid, None)
        self._human.discard(sid)
        self._human_driving.end(self._event(time.perf_counter_ns(), f"{DISCONNECTED}{reason}"))

    def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
        received_ns = time.perf_counter_ns()
        self._last_s = time.monotonic()
        person = self._person
        if person is None or data is None:
            return Answer(None, lambda _: self._note(sid, received_ns, self._parsed(sid, data)))
        parsed = self._parsed(sid, data)
        self._handle_requests(person)
        device, brake = person.control.device, person.brake  # in force when this picture was taken
        speed_mph = None if parsed is None else parsed.speed_mph
        command = person.command(
            parsed if isinstance(parsed, Telemetry) else None,
            math.nan if speed_mph is None else speed_mph,
            self._separators.get(sid, POINT),
        )
        is_taken = person.takes_row()
        return Answer(command, lambda _: self._note(sid, received_ns, parsed, device, brake, is_taken=is_taken))

    def unanswered(self, sid: str, data: object, received_s: float) -> None:
        received_ns = round(received_s * 1e9)
        self._last_s = time.monotonic()
        self._event(received_ns, "too many telemetries in flight: one is left unanswered")
        device, brake = (None, 0.0) if self._person is None else (self._person.control.device, self._person.brake)
        is_taken = self._person is None or self._person.takes_row()
        self._note(sid, received_ns, self._parsed(sid, data), device, brake, is_taken=is_taken)

    def first_command_sent(self, sid: str) -> None:
        sent = "manual" if self._person is None else "a command"
        text = f"no telemetry for a second after the connection: {sent} was sent, to make the simulator begin"
        self._event(time.perf_counter_ns(), text)

    def final_command(self, sid: str) -> Steer | None:
        return None if self._person is None else Steer(0.0, 0.0, self._separators.get(sid, POINT))

    def tick(self) -> None:
        if self._person is not None:
            self._handle_requests(self._person)
        self._writer.flush_if_due()
        now_s = time.monotonic()
        since_s, rows = self._rate_from
        if now_s - since_s >= RATE_S:
            self._rate = (self.rows - rows) / (now_s - since_s)
            self._rate_from = (now_s, self.rows)
        if self._telemetries:
            self._first_connected_s = None
            self._text = (
                f"{counted(self.rows, 'row')}, {counted(self.pictures, 'picture')},"
                f" {self._writer.bytes_written / 1e6:,.1f} MB, {self._rate:,.0f} rows/s,"
                f" {len(self.skipped):,} skipped"
            )
        elif self._first_connected_s is not None and now_s - self._first_connected_s >= NO_TELEMETRY_S:
            self._first_connected_s = None
            self.show("connected, but no telemetry comes: choose Autonomous Mode in the simulator")
        self._status.show(self._text)

    def warn(self, text: str) -> None:
        """Report a client that is not a simulator, or unusable telemetry."""
        self._event(time.perf_counter_ns(), text, "WARNING")
        self.show(text)

    def show(self, text: str) -> None:
        self._text = text
        self._status.show_or_print(text)

    def finish(self) -> None:
        """Write the last events, when nothing more will come."""
        for text in self._bad.remaining():
            self._event(time.perf_counter_ns(), text, "WARNING")

    def is_idle_for(self, idle_s: float) -> bool:
        """True if the last telemetry came at least `idle_s` ago; False before the first."""
        return self._telemetries > 0 and time.monotonic() - self._last_s >= idle_s

    def why_nothing(self) -> str:
        if self._person is not None and self._telemetries:
            return "nothing was recorded: begin to record on the page, and drive"
        if self.skipped:
            return f"nothing was recorded{self.skipped.error_suffix()}"
        if self._manuals:
            return (
                "nothing was recorded: the simulator sends nothing while its keys are held; drive in its training"
                " mode and follow that by `bc-record NAME --from FOLDER --watch`"
            )
        if self._connections:
            return "nothing was recorded: a client connected, but sent no telemetry; start its autonomous mode"
        return "nothing was recorded: no simulator connected; start its autonomous mode while this waits for it"

    def _handle_requests(self, person: PersonOfTelemetry) -> None:
        for text in person.handle_requests():
            self._event(time.perf_counter_ns(), text)

    def _parsed(self, sid: str, data: object) -> Telemetry | TelemetryError | None:
        """A telemetry with a whole picture, or the reason why it is unusable; None while a human holds a key."""
        if data is None:
            return None
        try:
            telemetry = parse_telemetry(data, self._separators.get(sid), self._car)
            if telemetry.observed_separator is not None:
                self._separators[sid] = telemetry.observed_separator
            check_whole_picture(telemetry.picture)
        except TelemetryError as error:
            if error.decimal_separator is not None:
                self._separators[sid] = error.decimal_separator
            return error
        return telemetry

    def _note(
        self,
        sid: str,
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
            self._manuals += 1
            if not self._human:
                self._human_driving.begin(self._event(received_ns, HUMAN_DRIVES))
            self._human.add(sid)
            return
        if isinstance(telemetry, TelemetryError):
            self._note_unusable("telemetries", received_ns, telemetry.kind, str(telemetry))
            return
        time_ns = self._clock.row(received_ns, None if telemetry.world is None else telemetry.world.time_s)
        for text in self._world_notices.new_notices(telemetry.world_problems, clock_stands=self._clock.stands):
            self.warn(text)
        if not is_taken:
            return
        gap = self._gap_before(sid, time_ns)
        left_out_s = self._human_driving.take_s() + (gap.seconds if gap is not None else 0.0)
        write_telemetry(
            self._writer, time_ns, self.rows, telemetry, device, brake=brake, not_recorded_s=left_out_s
        )
        self.pictures += 1 + len(telemetry.side_pictures)
        for problem in telemetry.side_problems:
            self._note_unusable("pictures", received_ns, problem, problem)
        if gap is not None:
            self._writer.event(time_ns, str(gap), name="recorder")
        if self._person is not None:
            self._person.has_row(time_ns)
            self._last_row_ns = time_ns
        self.rows += 1

    def _gap_before(self, sid: str, time_ns: int) -> MeantGap | None:
        """The person's pause before a row, if there was one. A row also ends a human's driving."""
        if sid in self._human:
            self._human.remove(sid)
            if not self._human:
                self._human_driving.end(time_ns)
                self._writer.event(time_ns, HUMAN_HAS_STOPPED, "INFO", "recorder")
        why = "" if self._person is None else self._person.recording.gap_why
        gap_s = (time_ns - self._last_row_ns) / 1e9 - MAX_ROW_S
        return MeantGap(gap_s, why) if self.rows and why and gap_s > 0 else None

    def _note_unusable(self, noun: str, received_ns: int, kind: str, reason: str) -> None:
        """Note an unusable telemetry, or an unusable picture of a side camera."""
        if kind not in self._bad.counts:
            print_message(f"{'telemetry' if noun == 'telemetries' else 'a picture'} that cannot be used: {reason}")
        self.skipped.add(f"{noun} that cannot be used ({kind})", f"number {self._telemetries}")
        if (text := self._bad.take(kind, reason)) is not None:
            self._event(received_ns, text, "WARNING")

    def _event(self, happened_ns: int, text: str, level: EventLevel = "INFO") -> int:
        """Write an event, and return its log time."""
        time_ns = self._clock.event(happened_ns)
        self._writer.event(time_ns, text, level, "recorder")
        return time_ns
