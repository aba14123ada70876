"""Driving with a trained network: every telemetry is answered, and every answer is logged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dataset.preprocess import DESCRIPTION
from drive.driver import Decision, DriveLog, Driver
from model import Pilot
from recorder import LogWriter
from recorder.telemetry_server import Answer, Steer, TelemetryServer


class DriveServer:
    """Drives the real simulator and modern Socket.IO clients, any number of them, on one port."""

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
        """Starts to listen; port 0 takes a free one. Raises ListenError if that is not possible."""
        self._pilot = pilot
        self._set_speed_mph = set_speed_mph
        self._say = say
        self._log = DriveLog(log)
        self._drivers: dict[str, Driver] = {}
        self.malformed = 0
        self.manual = 0
        self._server = TelemetryServer(self, host=host, port=port)
        self.port = self._server.port

    @property
    def frames(self) -> int:
        """Telemetries that were driven on and logged."""
        return self._log.frames

    def run(self, until: Callable[[], bool]) -> None:
        """Serve until `until()` is true.

        Raises UserError if the log cannot be written any more.
        """
        self._server.run(until)

    def connected(self, sid: str) -> None:
        self._log.event("connected")
        self._say("connected, waiting for telemetry")

    def disconnected(self, sid: str, reason: str) -> None:
        self._drivers.pop(sid, None)
        self._log.event(f"disconnected: {reason}")
        self._say(f"disconnected after {self.frames:,} frames ({reason}); waiting")

    def telemetry(self, sid: str, data: object) -> Answer:
        if data is None:  # a human holds a key
            return Answer(None, self._note_manual)
        driver = self._drivers.get(sid)
        if driver is None:
            driver = self._drivers[sid] = Driver(self._pilot, self._set_speed_mph)
        decision = driver.decide(data)
        return Answer(
            Steer(decision.steering, decision.throttle, decision.decimal_comma),
            lambda total_ms: self._note(decision, driver.set_speed_mph, total_ms),
        )

    def tick(self) -> None:
        self._log.flush_if_due()

    def _note_manual(self, total_ms: float) -> None:
        self.manual += 1
        if self.manual == 1:
            self._log.event("manual: a human drives")

    def _note(self, decision: Decision, set_speed_mph: float, total_ms: float) -> None:
        self.malformed += decision.telemetry is None
        self._log.decision(decision, set_speed_mph, total_ms)


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
