"""The server that the simulator connects to: every telemetry is answered, and every answer is logged."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import socketio

from dataset.preprocess import DESCRIPTION
from drive.driver import DriveLog, Driver
from drive.green import eventlet
from drive.listener import listen
from drive.old_clients import accept_old_clients
from drive.telemetry import MAX_IMAGE_BYTES, format_command
from model import Pilot
from recorder import LogWriter

TICK_S = 0.1


class DriveServer:
    """Serves the real simulator and modern Socket.IO clients, any number of them, on one port."""

    def __init__(
        self,
        pilot: Pilot,
        log: LogWriter,
        *,
        host: str = "127.0.0.1",
        port: int = 4567,
        set_speed_mph: float = 10.0,
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Starts to listen; port 0 takes a free one. Raises DriveError if that is not possible."""
        self._pilot = pilot
        self._set_speed_mph = set_speed_mph
        self._say = say
        self._log = DriveLog(log)
        self._drivers: dict[str, Driver] = {}
        self._stopped = False
        self.malformed = 0
        self.manual = 0
        self._listener = listen(host, port)
        self.port: int = self._listener.getsockname()[1]
        self._server = socketio.Server(
            async_mode="eventlet",
            async_handlers=False,
            # above it the connection is cut; a picture that is too large is answered first
            max_http_buffer_size=4 * MAX_IMAGE_BYTES,
        )
        self._server.on("connect", self._on_connect)
        self._server.on("disconnect", self._on_disconnect)
        self._server.on("telemetry", self._on_telemetry)
        accept_old_clients(self._server)

    @property
    def frames(self) -> int:
        """Telemetries that were driven on and logged."""
        return self._log.frames

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Serve until `stop()` is called (from a signal handler or another green thread), or `until()` is true."""
        web = eventlet.spawn(
            eventlet.wsgi.server, self._listener, socketio.WSGIApp(self._server), log_output=False
        )
        try:
            while not (self._stopped or until()):
                # a tick, because a signal does not wake eventlet, and a flush is due also while nothing arrives
                eventlet.sleep(TICK_S)
                self._log.flush_if_due()
            for sid, driver in list(self._drivers.items()):
                self._emit(sid, 0.0, 0.0, driver.decimal_comma)  # the car keeps its last command: let it roll out
            eventlet.sleep(TICK_S)
        finally:
            web.kill()
            self._listener.close()

    def stop(self) -> None:
        self._stopped = True

    def stop_on_signals(self) -> None:
        """Let Ctrl-C and `kill` end `run()` between two telemetries, and never in the middle of one."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: self.stop())

    def _on_connect(self, sid: str, environ: dict[str, Any]) -> None:
        self._log.event("connected")
        self._say("connected, waiting for telemetry")

    def _on_disconnect(self, sid: str, reason: str) -> None:
        self._drivers.pop(sid, None)
        self._log.event(f"disconnected: {reason}")
        self._say(f"disconnected after {self.frames:,} frames ({reason}); waiting")

    def _on_telemetry(self, sid: str, data: object = None, *_: object) -> None:
        start_s = time.perf_counter()
        if data is None:  # a human holds a key
            self._server.emit("manual", {}, to=sid)
            self.manual += 1
            if self.manual == 1:
                self._log.event("manual: a human drives")
            return
        driver = self._drivers.get(sid)
        if driver is None:
            driver = self._drivers[sid] = Driver(self._pilot, self._set_speed_mph)
        decision = driver.decide(data)
        self._emit(sid, decision.steering, decision.throttle, decision.decimal_comma)
        total_ms = (time.perf_counter() - start_s) * 1e3
        self._server.sleep(0)  # the answer leaves now; writing it down comes after
        self.malformed += decision.telemetry is None
        self._log.decision(decision, driver.set_speed_mph, total_ms)

    def _emit(self, sid: str, steering: float, throttle: float, decimal_comma: bool) -> None:
        self._server.emit("steer", format_command(steering, throttle, decimal_comma), to=sid)


def drive_metadata(pilot: Pilot, set_speed_mph: float) -> dict[str, str]:
    """What a drive's log says of itself."""
    return {
        "source": "drive",
        "driver": "pilot",
        "run": pilot.run,
        "weights_sha256": pilot.weights_sha256,
        "set_speed_mph": f"{set_speed_mph:g}",
        **{f"preprocessing.{name}": value for name, value in DESCRIPTION.items()},
    }


def open_log(path: Path, pilot: Pilot, set_speed_mph: float, *, overwrite: bool) -> LogWriter:
    """The log of a drive: flushed every second, so that a killed drive loses no more than that."""
    return LogWriter(path, drive_metadata(pilot, set_speed_mph), overwrite=overwrite, live=True)
