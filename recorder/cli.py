"""`bc-record`: records a drive to a log, or imports one."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from common.command import run_command
from common.location_flag import LocationFlag
from recorder.sources.gymnasium_flags import GymFlags
from recorder.sources.simulated_drive import SimulatedDrive
from recorder.sources.topic_flags import Topics

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class Record:
    """Record a session to sessions/NAME.mcap: from the built-in simulator, a running one, or a recording.

    bc-record lake --track lake --laps 0.5
    bc-record mine --driver me --track lake --open
    bc-record mine --from ~/beta_simulator/recording --watch
    bc-record racing --gym CarRacing-v3 --gym-action steering,throttle,brake --expert my_expert:drive
    """

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """Name of the session, without folder or ending."""
    source: Annotated[LocationFlag | None, tyro.conf.arg(name="from", metavar="SOURCE")] = None
    """Import a Udacity folder, DonkeyCar tub, .mcap, ROS 2 bag, LeRobot dataset, or csv."""
    watch: bool = False
    """Follow the folder of --from while the simulator writes it."""
    listen: bool = False
    """Record the telemetry of a simulator that connects."""
    idle: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """End --watch or --listen after this long without new data; otherwise, Ctrl-C ends them."""
    viewer: bool = False
    """Show what --watch or --listen records, in Rerun."""
    host: str = "127.0.0.1"
    """Address for --listen; 0.0.0.0 lets other machines connect."""
    port: int = 4567
    """Port for --listen; Udacity's simulator connects to 4567."""
    car: Annotated[str | None, tyro.conf.arg(metavar="udacity|built-in|FILE.toml")] = None
    """The recorded car: steering angle, cameras, unit of speed. By default Udacity's."""
    topics: tyro.conf.OmitArgPrefixes[Topics] = field(default_factory=Topics)
    columns: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WHAT=COLUMN [WHAT=COLUMN ...]")] = ()
    """Columns of a csv next to pictures: image=frame steering=angle, and more."""
    all_catalogs: bool = False
    """Also import a tub's catalogues that its manifest does not name."""
    rate: float | None = None
    """Rows a second; the built-in simulator's rate (10 by default) must divide 50."""
    udacity: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Also write the simulated drive as a Udacity recording, to a new folder."""
    sessions: LocationFlag = Path("sessions")
    """Folder of the logs; finished logs are copied to a URL."""
    force: bool = False
    """Replace a session of the same name."""
    copy_to: Annotated[LocationFlag | None, tyro.conf.arg(metavar="URL")] = None
    """Also copy the finished log there (s3://BUCKET/FOLDER)."""
    open: bool = False
    """With --driver me: open the page in a browser."""
    page: bool = True
    """With --driver me: serve the page; --no-page if a bc-web runs here."""
    drive: tyro.conf.OmitArgPrefixes[SimulatedDrive] = field(default_factory=SimulatedDrive)
    environment: tyro.conf.OmitArgPrefixes[GymFlags] = field(default_factory=GymFlags)
    wander: float = 0.0
    """With --gym: disturb the expert's steering by this standard deviation, such as 0.1."""


def _record(config: Record) -> int:
    from recorder.record_command import record  # NumPy, Arrow, Protobuf, OpenCV

    return record(config)


def main() -> None:
    run_command("bc-record", Record, _record)
