"""The built-in simulator as a separate process, which connects to the drive's server."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from common.interrupts import StopEvent, stop_signals
from common.tasks import report_share
from drive.config import DriveConfig
from drive.drive_server import DriveServer
from drive.errors import DriveError
from model import Pilot
from simulator.driving.drive_limits import MAX_LAPS
from simulator.roads.track import load_track

SIMULATOR_METADATA: Final = "bc.simulator"
"""The metadata record of a log that holds the simulator's own report of the drive."""

END_S: Final = 10.0
"""The time after which a terminated simulator is killed."""


@dataclass(frozen=True)
class BuiltInSimulator:
    """The built-in simulator on a track (lake, mountain, random:SEED, hairpins:SEED)."""

    track: str
    laps: float = 1.0
    real_time: bool = False
    """Run no faster than the clock; else the simulator runs as fast as the answers come."""
    leave_off_road: bool = False
    """Put the car back only if it is stuck: off the road, a person or expert takes over."""
    start_m: float = 0.0
    """The start, in metres along the track."""

    def __post_init__(self) -> None:
        """Raises DriveError for a track or laps that cannot be driven."""
        check_laps(self.laps)
        try:
            load_track(self.track)
        except ValueError as error:
            raise DriveError(f"{self.track}: {error}") from None


def check_laps(laps: float) -> None:
    """Raise DriveError for a number of laps that cannot be driven."""
    if not 0 < laps <= MAX_LAPS:
        raise DriveError(f"--laps {laps:g}: give a number above 0 and up to {MAX_LAPS:,}")


def drive_and_log(
    pilot: Pilot,
    simulator: BuiltInSimulator,
    config: DriveConfig,
    log: Path,
    *,
    overwrite: bool = False,
    shows_progress: bool = True,
) -> dict[str, Any]:
    """Drive the built-in simulator, in lock-step unless it keeps real time, and log the drive. Returns the
    simulator's report.

    Raises DriveError if the simulator fails, KeyboardInterrupt if the drive was stopped. The log is finished in
    any case.
    """
    with (
        stop_signals() as stopped,
        DriveServer(pilot, config, log, overwrite=overwrite, port=0, track=simulator.track) as server,
    ):
        report = drive_built_in(server, simulator, stopped, shows_progress=shows_progress)
        if not report:
            raise KeyboardInterrupt
        return report


def drive_built_in(
    server: DriveServer, simulator: BuiltInSimulator, stopped: StopEvent, *, shows_progress: bool = True
) -> dict[str, Any]:
    """Start the built-in simulator, and serve until it has driven its laps or `stopped` is set.

    Returns the simulator's report, which the log keeps, too; empty if the drive was stopped. Raises DriveError if
    the simulator fails. Without `shows_progress`, it draws no bar on the terminal.
    """

    def has_ended() -> bool:
        report_share(min(1.0, (server.session.summary.laps or 0.0) / simulator.laps))
        return process.poll() is not None

    with _process(server, simulator, shows_progress=shows_progress) as process:
        server.run(until=has_ended, stopped=stopped)
        if process.poll() is None:
            return {}
        output, errors = process.communicate()
        if process.returncode != 0:
            why = (errors or b"").decode(errors="replace").strip().rpartition("\n")[2]
            code = f"the simulator on {simulator.track} ended with exit code {process.returncode}"
            raise DriveError(f"{code}: {why}" if why else code)
        report: dict[str, Any] = json.loads(output)
        if report["gave_up"] and not shows_progress:  # else the simulator has printed it itself
            server.notify("the car made no progress for a minute: given up")
        server.session.add_metadata(SIMULATOR_METADATA, {name: str(value) for name, value in report.items()})
        return report


@contextmanager
def _process(
    server: DriveServer, simulator: BuiltInSimulator, *, shows_progress: bool
) -> Iterator[subprocess.Popen[bytes]]:
    config = server.config
    command = [
        *(sys.executable, "-P", "-m", "simulator.cli", "--json", "--tell-world", "--port", str(server.port)),
        *("--track", simulator.track, "--laps", str(simulator.laps), "--start", str(simulator.start_m)),
        *("--expert-speed", str(config.set_speed_mph)),
        *(["--leave-off-road"] if config.takeover or simulator.leave_off_road else []),
        *(["--real-time"] if simulator.real_time else []),
    ]
    # In a new session, so that Ctrl-C reaches only this process, and the drive ends between two messages.
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=None if shows_progress else subprocess.PIPE, start_new_session=True
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
