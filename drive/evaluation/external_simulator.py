"""A simulator that connects by itself, for the rounds of an aggregation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from common.interrupts import stop_signals
from common.output import print_message
from common.progress import StatusLine
from drive.config import DriveConfig
from drive.control.takeover import REQUIRED_MEMBERS
from drive.drive_server import DriveServer
from drive.drive_session import DriveSession
from drive.errors import DriveError
from drive.evaluation.simulator_process import check_laps
from drive.log.drive_summary import DriveSummary
from model import Pilot
from recorder.server.telemetry_server import ServerMode

FRAMES_WITHOUT_EXPERT: Final = 25
"""A simulator that sends no expert's command in so many frames has none."""


@dataclass(frozen=True)
class ExternalSimulator:
    """A simulator that is waited for at an address, and driven for so many laps, if it sends them, or until it
    disconnects."""

    laps: float = 1.0
    host: str = "127.0.0.1"
    port: int = 4567

    name = "connected"
    """The part of the names of logs and runs that stands for it."""
    flags = ()
    """The flags of bc-drive that choose it."""

    def __post_init__(self) -> None:
        """Raises DriveError for laps that cannot be driven."""
        check_laps(self.laps)

    @property
    def description(self) -> str:
        return f"a simulator that connects to {self.host}:{self.port}"

    def drive(self, pilot: Pilot, config: DriveConfig, log: Path, mode: ServerMode) -> DriveSummary:
        """Wait for it, drive it, and log that; the summary of the log.

        Raises DriveError where it has no expert that could take over, ListenError if the port is taken,
        KeyboardInterrupt if it was stopped; the log is finished then too.
        """
        with StatusLine() as status, stop_signals(max_signals=2) as stopped:

            def notify(text: str) -> None:
                print_message(f"bc-drive: {text}")

            with DriveServer(
                pilot,
                config,
                log,
                host=self.host,
                port=self.port,
                mode=mode,
                notify=notify,
                show_status=status.show,
            ) as server:
                session = server.session
                notify(f"{pilot.run} is waiting for a simulator on {self.host}:{server.port}")
                server.run(until=lambda: self._is_over(session), stopped=stopped)
                if stopped.is_set():
                    raise KeyboardInterrupt
        summary = session.summary
        if not summary.has_expert:
            raise DriveError(
                f"{log}: nobody could take over, so there is nothing to learn from: the simulator never sends"
                f" {', '.join(REQUIRED_MEMBERS)} (`bc-sim --tell-world` does); move the log away to begin again"
            )
        return summary

    def _is_over(self, session: DriveSession) -> bool:
        summary = session.summary
        if summary.laps is not None and summary.laps >= self.laps:
            return True
        if summary.frames >= FRAMES_WITHOUT_EXPERT and not summary.has_expert:
            return True
        return summary.frames > 0 and not session.is_connected
