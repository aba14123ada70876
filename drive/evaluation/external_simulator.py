"""Driving a simulator that connects by itself, for as long as a round of an aggregation lasts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from common.interrupts import stop_signals
from common.output import print_message
from common.progress import StatusLine
from drive.config import DriveConfig
from drive.control.takeover import NEEDED
from drive.errors import DriveError
from drive.evaluation.closed_loop import check_laps
from drive.log.summary import DriveSummary
from drive.server import DriveServer
from drive.session import DriveSession
from model import Pilot
from recorder.server.telemetry_server import ServerMode

FRAMES_WITHOUT_EXPERT: Final = 25
"""A simulator that tells of no expert in so many frames has none."""


@dataclass(frozen=True)
class Connecting:
    """Where a simulator is waited for, and how far it drives: so many laps, if it tells them, and no farther than
    until it disconnects."""

    laps: float = 1.0
    host: str = "127.0.0.1"
    port: int = 4567

    name = "connected"
    """What logs and runs are called after it."""
    flags = ()
    """What of a command line chooses it."""

    def __post_init__(self) -> None:
        """Raises DriveError for laps that nobody can drive."""
        check_laps(self.laps)

    @property
    def where(self) -> str:
        return f"a simulator that connects to {self.host}:{self.port}"

    def drive(self, pilot: Pilot, config: DriveConfig, log: Path, mode: ServerMode) -> DriveSummary:
        """Wait for it, drive it, and log that: what the log says in the end.

        Raises DriveError where it tells of no expert who could take over, ListenError if the port is taken,
        KeyboardInterrupt if it was stopped; the log is finished then too.
        """
        with StatusLine() as status, stop_signals(max_signals=2) as stopped:

            def say(text: str) -> None:
                print_message(f"bc-drive: {text}")

            with DriveServer(
                pilot, config, log, host=self.host, port=self.port, mode=mode, say=say, show=status.show
            ) as server:
                session = server.session
                say(f"{pilot.run} is waiting for a simulator on {self.host}:{server.port}")
                server.run(until=lambda: self._is_over(session), stopped=stopped)
                if stopped.is_set():
                    raise KeyboardInterrupt
        summary = session.summary
        if not summary.has_expert:
            raise DriveError(
                f"{log}: nobody could take over, so that there is nothing to learn from: the simulator never tells"
                f" {', '.join(NEEDED)} (`bc-sim --tell-world` does); move the log away to begin again"
            )
        return summary

    def _is_over(self, session: DriveSession) -> bool:
        summary = session.summary
        if summary.laps is not None and summary.laps >= self.laps:
            return True
        if summary.frames >= FRAMES_WITHOUT_EXPERT and not summary.has_expert:
            return True
        return summary.frames > 0 and not session.is_connected
