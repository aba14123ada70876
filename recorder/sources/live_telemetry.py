"""Recording the telemetry of connected simulators into a log."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

from common import Skipped
from common.errors import counted
from common.files import refuse_existing
from common.interrupts import stop_signals
from common.output import print_message
from common.progress import StatusLine
from recorder.bc_pb2 import VehicleState
from recorder.errors import RecordingError
from recorder.log.bad_telemetry import BadTelemetry
from recorder.log.log_time import LogClock
from recorder.log.pose_message import pose_message
from recorder.log.session_car import UDACITY, Car, metadata_of
from recorder.log.writer import EventLevel, LogWriter
from recorder.server.telemetry import TelemetryError, check_whole_jpeg, parse_telemetry
from recorder.server.telemetry_server import NO_TELEMETRY_S, Answer, Steer, TelemetryServer
from recorder.server.world import WorldNotices
from recorder.sources.import_result import Imported

RATE_S = 1.0  # the rows a second that are shown are those of this last while


def listen_for_telemetry(
    log: Path,
    *,
    host: str = "127.0.0.1",
    port: int = 4567,
    idle_s: float | None = None,
    overwrite: bool = False,
    car: Car | None = None,
    on_started: Callable[[Path], None] | None = None,
) -> Imported:
    """Record the telemetry of Socket.IO clients on host:port (port 0: a free one) to `log`. Every telemetry is
    answered by `manual`, which asks for the next one.

    Ends on Ctrl-C or `kill`, or `idle_s` seconds after the last telemetry; outside the main thread, which alone
    hears signals, only on the latter. `on_started` gets the path of the growing file, once the server listens.
    `car` is theirs, if that is not Udacity's or the built-in one's.

    Raises RecordingError if not one telemetry came that can be used, ListenError if the port is taken, UserError
    if `log` exists and `overwrite` is off, or if it cannot be written any further.
    """
    refuse_existing(log, overwrite)
    with stop_signals() as stopped, contextlib.ExitStack() as writing:
        writer = writing.enter_context(
            LogWriter(log, {"source": "telemetry"} | metadata_of(car), overwrite=overwrite, live=True)
        )
        with StatusLine() as status:
            session = _Session(writer, status, car or UDACITY)
            server = TelemetryServer(session, host=host, port=port, notify=session.warn, first_command="manual")
            session.show(f"waiting for a simulator on {host}:{server.port}")
            if on_started is not None:
                on_started(writer.part)
            server.run(until=lambda: stopped.is_set() or (idle_s is not None and session.is_idle_for(idle_s)))
        session.finish()
        if not session.rows:
            writing.pop_all()  # a live log would be kept, for its events
            writer.discard()
            raise RecordingError(f"{log}: {session.why_nothing()}")
    return Imported(log, session.rows, session.rows, session.skipped, writer.notices)


class _Session:
    """Writes telemetry to a log; rows are numbered from 0, and no time is the same as or before the last one."""

    def __init__(self, writer: LogWriter, status: StatusLine, car: Car) -> None:
        self._car = car
        self._writer = writer
        self._status = status
        self._text = ""
        self._connections = 0
        self._first_connected_s: float | None = None  # until its first telemetry, or none came for too long
        self._telemetries = 0
        self._manuals = 0
        self._clock = LogClock(from_wall_clock=True)
        self._world_notices = WorldNotices()
        self._separators: dict[str, str] = {}  # of decimals, by connection
        self._last_s = 0.0
        self._rate_from = (time.monotonic(), 0)
        self._rate = 0.0
        self.rows = 0
        self.skipped = Skipped()
        self._bad = BadTelemetry()

    def connected(self, sid: str) -> None:
        self._event(time.time_ns(), "connected")
        self._connections += 1
        if self._connections == 1:
            self._first_connected_s = time.monotonic()
            self.show("connected, waiting for telemetry")

    def disconnected(self, sid: str, reason: str) -> None:
        self._separators.pop(sid, None)
        self._event(time.time_ns(), f"disconnected: {reason}")

    def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
        received_ns = time.time_ns()
        self._last_s = time.monotonic()
        return Answer(None, lambda _: self._note(sid, received_ns, data))

    def final_command(self, sid: str) -> Steer | None:
        return None  # nobody was steered

    def tick(self) -> None:
        self._writer.flush_if_due()
        now_s = time.monotonic()
        since_s, rows = self._rate_from
        if now_s - since_s >= RATE_S:
            self._rate = (self.rows - rows) / (now_s - since_s)
            self._rate_from = (now_s, self.rows)
        if self._telemetries:
            self._first_connected_s = None
            self._text = (
                f"{counted(self.rows, 'row')}, {counted(self.rows, 'picture')},"
                f" {self._writer.bytes_written / 1e6:,.1f} MB, {self._rate:,.0f} rows/s,"
                f" {len(self.skipped):,} skipped"
            )
        elif self._first_connected_s is not None and now_s - self._first_connected_s >= NO_TELEMETRY_S:
            self._first_connected_s = None
            self.show("connected, but no telemetry comes: choose Autonomous Mode in the simulator")
        self._status.show(self._text)

    def warn(self, text: str) -> None:
        """Report a client that is no simulator, or telemetry that cannot be used."""
        self._event(time.time_ns(), text, "WARNING")
        self.show(text)

    def show(self, text: str) -> None:
        """Show it in the status line; where there is none, print it."""
        self._text = text
        self._status.show_or_print(text)

    def finish(self) -> None:
        """To be called when nothing more will come."""
        for text in self._bad.left():
            self._event(time.time_ns(), text, "WARNING")

    def is_idle_for(self, idle_s: float) -> bool:
        """True if the last telemetry came so long ago; False before the first."""
        return self._telemetries > 0 and time.monotonic() - self._last_s >= idle_s

    def why_nothing(self) -> str:
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

    def _note(self, sid: str, received_ns: int, data: object) -> None:
        self._telemetries += 1
        if data is None:  # a human holds a key
            self._manuals += 1
            if self._manuals == 1:
                self._event(received_ns, "manual: a human drives")
            return
        try:
            telemetry = parse_telemetry(data, self._separators.get(sid), self._car)
            if telemetry.observed_separator is not None:
                self._separators[sid] = telemetry.observed_separator
            size = check_whole_jpeg(telemetry.jpeg)
        except TelemetryError as error:
            if error.kind not in self._bad.counts:
                print_message(f"telemetry that cannot be used: {error}")
            self.skipped.add(f"telemetries that cannot be used ({error.kind})", f"number {self._telemetries}")
            if (text := self._bad.take(error.kind, str(error))) is not None:
                self._event(received_ns, text, "WARNING")
            return
        time_ns = self._clock.row(received_ns, None if telemetry.world is None else telemetry.world.time_s)
        for text in self._world_notices.new_notices(telemetry.world_problems, clock_stands=self._clock.stands):
            self.warn(text)
        self._writer.picture("center", time_ns, self.rows, telemetry.jpeg, size)
        state = VehicleState(
            steering=telemetry.steering, throttle=telemetry.throttle, brake=0.0, speed_mph=telemetry.speed_mph
        )
        self._writer.vehicle(time_ns, self.rows, state)
        pose = None if telemetry.world is None else telemetry.world.pose
        if pose is not None:
            self._writer.pose(time_ns, self.rows, pose_message(pose, time_ns))
        self.rows += 1

    def _event(self, time_ns: int, text: str, level: EventLevel = "INFO") -> None:
        self._writer.event(self._clock.event(time_ns), text, level, "recorder")
