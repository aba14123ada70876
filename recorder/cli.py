"""`bc-record`: records a drive to a log, or imports one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from common.command import run_command
from common.location_flag import LocationFlag
from recorder.sources.gymnasium_flags import REMOVED_GYM_FLAGS, GymFlags
from recorder.sources.settings import SimulatedDrive, Topics


@dataclass(frozen=True)
class Record:
    """Record a session to sessions/NAME.mcap: from the built-in simulator, a running one, or a recording.

    bc-record lake --track lake --laps 0.5
    bc-record mine --driver me --track lake --open
    bc-record mine --from ~/beta_simulator/recording --watch
    """

    RARE: ClassVar[str] = "idle host port topics columns udacity copy_to page wander"
    REMOVED: ClassVar[Mapping[str, str]] = REMOVED_GYM_FLAGS
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """Name of the session, without folder or ending."""
    source: Annotated[Path | None, tyro.conf.arg(name="from", metavar="SOURCE")] = None
    """Import a Udacity folder, DonkeyCar tub, .mcap, ROS 2 bag, LeRobot dataset or csv."""
    watch: bool = False
    """Follow the folder of --from as it is written."""
    listen: bool = False
    """Record a simulator that connects."""
    idle: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """End --watch or --listen after this long without data."""
    viewer: bool = False
    """Show --watch or --listen in Rerun."""
    host: str = "127.0.0.1"
    """Address for --listen; 0.0.0.0 admits other machines."""
    port: int = 4567
    """Port for --listen."""
    car: Annotated[str | None, tyro.conf.arg(metavar="udacity|built-in|FILE.toml")] = None
    """The car: steering angle, wheelbase, unit of speed; by default Udacity's."""
    topics: tyro.conf.OmitArgPrefixes[Topics] = field(default_factory=Topics)
    columns: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WHAT=COLUMN [WHAT=COLUMN ...]")] = ()
    """Columns of a csv: image=frame steering=angle, and more."""
    rate: Annotated[float | None, tyro.conf.arg(metavar="HZ")] = None
    """Rows a second; built-in: 10 or another divisor of 50."""
    udacity: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Also write the simulated drive as a Udacity recording."""
    sessions: LocationFlag = Path("sessions")
    """Folder of the logs, or a URL for copies."""
    force: bool = False
    """Replace a session of the same name."""
    copy_to: Annotated[LocationFlag | None, tyro.conf.arg(metavar="URL")] = None
    """Also copy the finished log to this store."""
    open: bool = False
    """With --driver me: open the browser."""
    page: bool = True
    """With --driver me: serve no page, but use that of a running bc-web."""
    drive: tyro.conf.OmitArgPrefixes[SimulatedDrive] = field(default_factory=SimulatedDrive)
    environment: tyro.conf.OmitArgPrefixes[GymFlags] = field(default_factory=GymFlags)
    wander: float = 0.0
    """With --gym: standard deviation of noise in the expert's steering, such as 0.1."""


def _record(config: Record) -> int:
    from recorder.record_command import record  # NumPy, Arrow, Protobuf, OpenCV

    return record(config)


def main() -> None:
    run_command("bc-record", Record, _record)
