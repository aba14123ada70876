"""`bc-drive`: a trained network drives the simulator."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

import tyro

from common.command import DONE, run_command, stderr
from common.files import refuse_existing
from common.interrupts import stop_signals
from drive.speed import check_set_speed


@dataclass(frozen=True)
class Drive:
    """Drive the simulator with a trained network, and log the drive.

    Start the simulator in autonomous mode before or after; Ctrl-C ends the drive and finishes the log.
    """

    run: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[RUN]")] = None
    """The run that drives, by name or folder; the newest one by default."""
    log: Path | None = None
    """Where the drive is logged; by default drives/DATE.mcap."""
    simulator: Annotated[str | None, tyro.conf.arg(metavar="TRACK")] = None
    """Start the built-in simulator on a track (lake, mountain, random:SEED), and end when it has driven."""
    laps: float = 1.0
    """How far the built-in simulator drives."""
    speed: float = 10.0
    """Set speed in mph."""
    host: str = "127.0.0.1"
    """Address to listen on; other machines are let in by 0.0.0.0."""
    port: int = 4567
    """Port to listen on; the simulator connects to 4567."""
    runs: Path = Path("runs")
    """Where runs are kept."""
    force: bool = False
    """Replace a log of the same name."""


def drive(config: Drive) -> int:
    check_set_speed(config.speed)
    path = config.log or Path("drives") / f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}.mcap"
    refuse_existing(path, config.force)  # before the seconds that torch takes to load

    from drive.closed_loop import Course, drive_built_in
    from drive.server import DriveServer, open_log
    from model import find_run, load_pilot

    course = Course(config.simulator, config.laps, config.speed) if config.simulator is not None else None
    console = stderr()
    pilot = load_pilot(find_run(config.run, config.runs))
    pilot.get_ready()
    with stop_signals() as stopped, open_log(path, pilot, config.speed, overwrite=config.force) as log:
        server = DriveServer(
            pilot,
            log,
            host=config.host,
            port=config.port,
            set_speed_mph=config.speed,
            say=lambda text: console.print(f"bc-drive: {text}"),
        )
        if course is None:
            console.print(f"bc-drive: {pilot.run} is waiting for a simulator on {config.host}:{server.port}")
            server.run(until=stopped.is_set)
        else:
            book = drive_built_in(server, course, stopped)
            if book:
                print(
                    f"{course.track}: {book['laps']:.2f} laps, {book['interventions']} interventions,"
                    f" autonomy {book['autonomy_percent']:.1f} %"
                )
    extra = f", {server.malformed:,} malformed telemetries" if server.malformed else ""
    print(f"{path}: {server.frames:,} frames{extra}; look at it with `bc-play {path}`")
    return DONE


def main() -> None:
    run_command("bc-drive", Drive, drive)
