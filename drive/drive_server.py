"""The server of a drive: answers every telemetry message with the network's command, and logs every answer."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal, Self

from common import UserError
from common.errors import counted
from common.interrupts import StopEvent
from dataset.picture_spec import metadata_of
from drive.at_wheel import AtWheel
from drive.config import DriveConfig
from drive.drive_session import DriveSession
from model import Pilot
from recorder import LogWriter
from recorder.log.session_car import BUILT_IN
from recorder.log.session_car import metadata_of as car_metadata
from recorder.log.writer import log_beside
from recorder.server.telemetry_server import Answer, Steer, TelemetryServer

NO_TELEMETRY_S: Final = 3.0
"""A client that sends no telemetry for this time is in its menu, or is not a simulator."""
MAX_SIMULATORS: Final = 8
"""Maximum number of simulators at once, each with its own log. A further one gets `manual`: it drives by
itself."""
WAITING: Final = "connected, waiting for telemetry"
MENU: Final = "connected, but no telemetry comes: choose Autonomous Mode in the simulator"
BRAKING_S: Final = 5.0
"""Time limit for braking at the end. From 30 mph, the car stands in under 3 s."""


class DriveServer:
    """Drives Udacity's simulator and modern Socket.IO clients on one port.

    The drive is logged to `log`. A second simulator at the same time is driven, too, with its own log next to
    `log`. As a context manager, it finishes the logs.
    """

    def __init__(
        self,
        pilot: Pilot,
        config: DriveConfig,
        log: Path,
        *,
        overwrite: bool = False,
        host: str = "127.0.0.1",
        port: int = 4567,
        track: str | None = None,
        at_wheel: AtWheel | None = None,
        notify: Callable[[str], None] = lambda text: None,
        show_status: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Opens the log and starts to listen. Port 0 takes a free port.

        `notify` gets a line for each event; `show_status` gets the status of the drive ten times a second. With
        `track`, the simulator is the built-in one on that track: its silence is no fault, because it loses no
        telemetry, and it does not connect again. `at_wheel` lets a person take over from the network, in the first
        simulator that connects; when it has gone, in one that remains. Raises UserError if `log` exists and may
        not be overwritten, ListenError if the port is taken.
        """
        self._pilot = pilot
        self.config = replace(config, car=BUILT_IN) if track is not None else config
        self._log = log
        self._track = track
        self._at_wheel = at_wheel
        self.notify = notify
        self._show_status = show_status
        self._notified: set[str] = set()
        self._connections = 0
        self._driven: dict[str, DriveSession] = {}
        self._silent_since_s: dict[str, float] = {}  # clients without telemetry yet: time of their connection
        self._stopping_since_s: float | None = None
        self._stopping: set[DriveSession] = set()  # sessions that are braked at the end
        self.sessions: list[DriveSession] = []
        with ExitStack() as stack:
            self._stack = stack
            self._open_session(log, overwrite)
            first: Steer | Literal["nothing"] = "nothing" if track is not None else Steer(0.0, 0.0)
            self._server = TelemetryServer(self, host=host, port=port, notify=notify, first_command=first)
            stack.callback(self._server.close)
            self._stack = stack.pop_all()
        self.port = self._server.port

    @property
    def session(self) -> DriveSession:
        """The first simulator's session, with the log at the path that the caller gave."""
        return self.sessions[0]

    @property
    def no_drive_reason(self) -> str:
        if self._connections:
            return "a simulator connected, but sent no telemetry; choose its Autonomous Mode"
        return "no simulator connected; start its Autonomous Mode while bc-drive waits for it"

    def run(self, until: Callable[[], bool] = lambda: False, stopped: StopEvent | None = None) -> None:
        """Serve until `until()` is true, `stopped` is set, or a log cannot be written. Then brake every car to a
        stand, unless `stopped` is set again.

        Raises UserError if a log could not be written.
        """

        def is_over() -> bool:
            is_stop_requested = stopped is not None and stopped.is_set()
            is_end_asked = any(session.is_end_asked for session in self.sessions)
            if not (is_stop_requested or is_end_asked or until() or self._failure is not None):
                return False
            if self._stopping_since_s is None:
                self.stop()
            self._notify_stopping(may_hurry=is_stop_requested)
            is_late = time.monotonic() - (self._stopping_since_s or 0.0) >= BRAKING_S
            all_stand = all(session.is_at_rest for session in self._driven.values())
            return is_late or all_stand or (stopped is not None and stopped.again.is_set())

        self._server.run(is_over)
        for session in self._stopping:
            if text := session.end_notice():
                self.notify(text)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        self._stopping_since_s = time.monotonic()
        for session in self._driven.values():
            self._brake(session)
        self._push(DriveSession.brake_steer)

    def connected(self, sid: str) -> None:
        """Note a client. It gets a session with its first telemetry, because other programs never send
        telemetry."""
        self._connections += 1
        self._silent_since_s[sid] = time.monotonic()
        if not self._driven:
            self._notify_once(WAITING)

    def disconnected(self, sid: str, reason: str) -> None:
        self._silent_since_s.pop(sid, None)
        session = self._driven.pop(sid, None)
        if session is not None:
            if session.is_connected and session in self._stopping and not session.is_at_rest:
                session.rolling_reason = "its simulator has disconnected"
            session.disconnected(reason)
            for other in self._driven.values():
                session.hand_wheel_to(other)
            if self._track is None:
                frames = f"{session.writer.path} has {counted(session.log.frames, 'frame')} so far"
                self.notify(f"disconnected ({reason}): {frames}" + ("" if self._driven else "; waiting"))

    def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
        self._silent_since_s.pop(sid, None)
        session = self._session_of(sid)
        if session is None:
            return Answer(None, lambda total_ms: None)
        return session.telemetry(data, received_s, self._server.in_flight(sid))

    def unanswered(self, sid: str, data: object, received_s: float) -> None:
        if (session := self._session_of(sid)) is not None:
            session.unanswered(data, received_s)

    def first_command_sent(self, sid: str) -> None:
        if (session := self._session_of(sid)) is not None:
            session.first_command_sent()

    def tick(self) -> None:
        now_s = time.monotonic()
        for session in self.sessions:
            session.attend()
            if self._track is None:  # the built-in simulator's silence is no fault
                session.note_silence()
        self._push(DriveSession.watchdog_steer if self._stopping_since_s is None else DriveSession.brake_steer)
        shown = next((session for session in self.sessions if session.is_connected), self.session)
        if text := shown.status(now_s):
            self._show_status(text)
        for sid, since_s in list(self._silent_since_s.items()):
            if now_s - since_s >= NO_TELEMETRY_S:
                del self._silent_since_s[sid]
                self._notify_once(MENU)

    def final_command(self, sid: str) -> Steer | None:
        session = self._driven.get(sid)
        return None if session is None else session.final_command()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: Any) -> None:
        self._stack.__exit__(*exception)

    @property
    def _failure(self) -> UserError | None:
        return next((session.log.failure for session in self.sessions if session.log.failure is not None), None)

    def _brake(self, session: DriveSession) -> None:
        session.stop()
        if self._track is None:  # the built-in simulator's car disappears with its process
            self._stopping.add(session)

    def _notify_once(self, text: str) -> None:
        if text not in self._notified:
            self._notified.add(text)
            self.notify(text)

    def _notify_stopping(self, *, may_hurry: bool) -> None:
        """Give the notices of the braking. With `may_hurry`, a second Ctrl-C ends the drive at once."""
        for text in sorted({session.stop_notice for session in self._stopping if session.stop_notice}):
            self._notify_once(f"{text}; Ctrl-C again ends at once" if may_hurry else text)

    def _push(self, command_of: Callable[[DriveSession], Steer | None]) -> None:
        """Send due commands to simulators that send no telemetry. The built-in simulator needs none."""
        if self._track is not None:
            return
        for sid, session in list(self._driven.items()):  # a copy: a failed push disconnects a client
            steer = None if self._server.has_unread(sid) else command_of(session)
            if steer is not None:
                self._server.push(sid, steer)

    def _session_of(self, sid: str) -> DriveSession | None:
        """A client's session; None if the client is not driven."""
        session = self._driven.get(sid)
        if session is None and len(self._driven) >= MAX_SIMULATORS:
            self._notify_once(f"more than {MAX_SIMULATORS} simulators at once: the others are not driven")
            return None
        try:
            return session or self._session_for(sid)
        except UserError as error:  # the other simulators continue
            self._notify_once(f"a second simulator is not driven: {error}")
            return None

    def _session_for(self, sid: str) -> DriveSession:
        free = [session for session in self.sessions if not session.is_connected]
        taken = {session.writer.path for session in self.sessions}
        session = free[0] if free else self._open_session(log_beside(self._log, taken), overwrite=False)
        self._driven[sid] = session
        session.connected()
        self._notified -= {WAITING, MENU}
        if self._stopping_since_s is not None:
            self._brake(session)
        if not session.is_empty:
            self.notify(f"connected again: {session.writer.path} continues")
        elif session is not self.session:
            self.notify(
                f"a second simulator has connected: it is driven, too, and logged to {session.writer.path};"
                " close one of them if you did not want that"
            )
        return session

    def _open_session(self, path: Path, overwrite: bool) -> DriveSession:
        """A session with a log that is flushed twice a second, so that a kill loses at most half a second."""
        road = {} if self._track is None else {"track": self._track}
        metadata = drive_metadata(self._pilot, self.config) | road
        writer = LogWriter(path, metadata, overwrite=overwrite, live=True)
        at_wheel = None if self.sessions else self._at_wheel
        session = self._stack.enter_context(DriveSession(self._pilot, self.config, writer, self.notify, at_wheel))
        self.sessions.append(session)
        return session


def drive_metadata(pilot: Pilot, config: DriveConfig) -> dict[str, str]:
    """The metadata of a drive's log: the run, the configuration and the preprocessing."""
    return {
        "source": "drive",
        "driver": "pilot",
        "run": pilot.run,
        "weights_sha256": pilot.weights_sha256,
        "arithmetic": pilot.arithmetic,
        "device": pilot.device,
        **{
            name: f"{value:g}" if isinstance(value, float) else str(value)
            for name, value in vars(config).items()
            if name != "car"
        },
        **car_metadata(config.car),
        **metadata_of(pilot.picture),
    }
