"""Driving with a trained network: every telemetry is answered, and every answer is logged."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Final, Literal, Self

from common import UserError
from common.errors import counted
from common.interrupts import StopEvent, force_quit_announced
from dataset.preprocess import DESCRIPTION
from drive.config import DriveConfig
from drive.session import DriveSession
from model import Pilot
from recorder import LogWriter
from recorder.server.telemetry_server import Answer, ServerMode, Steer, TelemetryServer

QUIET_S: Final = 3.0
"""Whoever has connected and tells nothing for so long is in its menu, or no simulator."""
MOST_SIMULATORS: Final = 8
"""At once; each has a log of its own. One more is told to drive by itself."""
WAITING: Final = "connected, waiting for telemetry"
MENU: Final = "connected, but no telemetry comes: choose Autonomous Mode in the simulator"
MOST_COMINGS: Final = 3
"""Of a simulator that comes and goes, each time with lines that say so; then one says that no more will."""
BRAKING_S: Final = 5.0
"""From 30 mph the car stands in under 3 s; a simulator that does not go on is not waited for any longer."""


class DriveServer:
    """Drives the real simulator and modern Socket.IO clients on one port.

    The drive is logged to `log`. A second simulator at the same time is driven too, and logged beside it. As a
    context manager it finishes the logs.
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
        mode: ServerMode = "eventlet",
        is_built_in: bool = False,
        say: Callable[[str], None] = lambda text: None,
        show: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Opens the log and starts to listen; port 0 takes a free one.

        `say` is told what happens, `show` ten times a second how the drive goes.
        `is_built_in`: it is the built-in simulator. Its silence is no fault, for it loses no telemetry; it does
        not come back.
        Raises UserError if `log` exists and may not be overwritten, ListenError if the port is taken.
        """
        self._pilot = pilot
        self.config = config
        self._log = log
        self._is_built_in = is_built_in
        self.say = say
        self._show = show
        self._said: set[str] = set()
        self._connections = 0
        self._of: dict[str, DriveSession] = {}
        self._quiet: dict[str, float] = {}  # those that have told nothing yet -> when they connected
        self._stopping_since_s: float | None = None
        self._braked: set[DriveSession] = set()  # when it was stopping
        self.sessions: list[DriveSession] = []
        with ExitStack() as stack:
            self._stack = stack
            self._open_session(log, overwrite)
            first: Steer | Literal["nothing"] = "nothing" if is_built_in else Steer(0.0, 0.0)
            self._server = TelemetryServer(self, host=host, port=port, mode=mode, notify=say, first_command=first)
            self._stack = stack.pop_all()
        self.port = self._server.port

    @property
    def session(self) -> DriveSession:
        """The first simulator's: the one of the log that was asked for."""
        return self.sessions[0]

    @property
    def why_nothing(self) -> str:
        """What to say of a drive without a single telemetry."""
        if self._connections:
            return "a simulator connected, but told no telemetry; choose Autonomous Mode there"
        return "no simulator connected; start its Autonomous Mode while bc-drive waits for it"

    def run(self, until: Callable[[], bool] = lambda: False, stopped: StopEvent | None = None) -> None:
        """Serve until `until()` is true, `stopped` is set, or a log cannot be written any more, and every car is
        braked to a stand. The latter is not waited for when `stopped` is set again.

        Raises UserError if a log could not be written.
        """

        def is_over() -> bool:
            is_asked = stopped is not None and stopped.is_set()
            if not (is_asked or until() or self._failure is not None):
                return False
            if self._stopping_since_s is None:
                self.stop()
            self._say_how_it_stops(may_hurry=is_asked)
            return self._is_at_rest() or (stopped is not None and stopped.again.is_set())

        self._server.run(is_over)
        for session in self._braked:
            if text := session.end():
                self.say(text)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """From now on every car is braked to a stand."""
        self._stopping_since_s = time.monotonic()
        for session in self._of.values():
            self._brake(session)
        self._push(DriveSession.push_brake)

    def connected(self, sid: str) -> None:
        """Whose log it gets is seen when it tells telemetry: others connect too, and tell none."""
        self._connections += 1
        self._quiet[sid] = time.monotonic()
        if not self._of:
            self._say_once(WAITING)

    def disconnected(self, sid: str, reason: str) -> None:
        self._quiet.pop(sid, None)
        session = self._of.pop(sid, None)
        if session is not None:
            if session.is_connected and session in self._braked and not session.is_braked:
                session.rolls = "its simulator has gone"
            session.disconnected(reason)
            if not self._is_built_in and session.comings <= MOST_COMINGS:
                frames = f"{session.writer.path} has {counted(session.log.frames, 'frame')} so far"
                self.say(f"disconnected ({reason}): {frames}" + ("" if self._of else "; waiting"))

    def telemetry(self, sid: str, data: object, received_s: float) -> Answer:
        self._quiet.pop(sid, None)
        session = self._of.get(sid)
        if session is None and len(self._of) >= MOST_SIMULATORS:
            self._say_once(f"more than {MOST_SIMULATORS} simulators at once: the others are not driven")
            return Answer(None, lambda total_ms: None)
        try:
            session = session or self._session_for(sid)
        except UserError as error:  # whoever is driven already is driven on
            self._say_once(f"a second simulator is not driven: {error}")
            return Answer(None, lambda total_ms: None)
        return session.telemetry(data, received_s)

    def tick(self) -> None:
        now_s = time.monotonic()
        self._push(DriveSession.push if self._stopping_since_s is None else DriveSession.push_brake)
        shown = next((session for session in self.sessions if session.is_connected), self.session)
        if text := shown.status(now_s):
            self._show(text)
        for sid, since_s in list(self._quiet.items()):
            if now_s - since_s >= QUIET_S:
                del self._quiet[sid]
                self._say_once(MENU)

    def final_command(self, sid: str) -> Steer | None:
        session = self._of.get(sid)
        return None if session is None else session.rest()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    @property
    def _failure(self) -> UserError | None:
        return next((session.log.failure for session in self.sessions if session.log.failure is not None), None)

    def _is_at_rest(self) -> bool:
        is_late = time.monotonic() - (self._stopping_since_s or 0.0) >= BRAKING_S
        return is_late or all(session.is_braked for session in self._of.values())

    def _brake(self, session: DriveSession) -> None:
        session.stop()
        if not self._is_built_in:  # its car ends with it
            self._braked.add(session)

    def _say_once(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self.say(text)

    def _say_how_it_stops(self, *, may_hurry: bool) -> None:
        """Only what was sent. `may_hurry`: Ctrl-C was pressed, and a second one ends sooner."""
        for text in sorted({session.stopping for session in self._braked if session.stopping}):
            if not may_hurry:
                self._say_once(text)
            elif (text := f"{text}; Ctrl-C again ends at once") not in self._said:
                self._say_once(text)
                force_quit_announced()

    def _push(self, what: Callable[[DriveSession], Steer | None]) -> None:
        """To whoever tells nothing; the built-in simulator's silence is no fault."""
        if self._is_built_in:
            return
        for sid, session in list(self._of.items()):  # whoever cannot be sent anything disconnects meanwhile
            steer = what(session)
            if steer is not None:
                self._server.push(sid, steer)

    def _session_for(self, sid: str) -> DriveSession:
        """For one that tells for the first time since it connected."""
        free = [session for session in self.sessions if not session.is_connected]
        session = free[0] if free else self._open_session(self._free_name(), overwrite=False)
        self._of[sid] = session
        session.connected()
        if session.comings <= MOST_COMINGS:
            self._said -= {WAITING, MENU}
        if self._stopping_since_s is not None:
            self._brake(session)
        if not session.is_empty:
            if session.comings <= MOST_COMINGS:
                self.say(f"connected again: {session.writer.path} goes on")
            elif session.comings == MOST_COMINGS + 1:
                self.say("it comes and goes: no more is said of that, the log has it as events")
        elif session is not self.session:
            self.say(
                f"a second simulator has connected: it is driven too, and logged to {session.writer.path};"
                " close one of them if that is not meant"
            )
        return session

    def _free_name(self) -> Path:
        """Beside the log: run-2.mcap for run.mcap."""
        names = (self._log.with_stem(f"{self._log.stem}-{number}") for number in itertools.count(2))
        taken = {session.writer.path for session in self.sessions}
        return next(name for name in names if name not in taken and not os.path.lexists(name))

    def _open_session(self, path: Path, overwrite: bool) -> DriveSession:
        """Flushed twice a second, so that a killed drive loses no more than that."""
        writer = LogWriter(path, drive_metadata(self._pilot, self.config), overwrite=overwrite, live=True)
        session = self._stack.enter_context(DriveSession(self._pilot, self.config, writer, self.say))
        self.sessions.append(session)
        return session


def drive_metadata(pilot: Pilot, config: DriveConfig) -> dict[str, str]:
    """What a drive's log says of itself."""
    return {
        "source": "drive",
        "driver": "pilot",
        "run": pilot.run,
        "weights_sha256": pilot.weights_sha256,
        "arithmetic": pilot.arithmetic,
        **{
            name: f"{value:g}" if isinstance(value, float) else str(value)
            for name, value in asdict(config).items()
        },
        **{f"preprocessing.{name}": value for name, value in DESCRIPTION.items()},
    }
