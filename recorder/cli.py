"""`bc-record`: records a drive to a log."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Final

import tyro

from common.command import run_command
from recorder.sources.gymnasium_flags import REMOVED_GYM_FLAGS, GymFlags
from recorder.sources.settings import SimulatedDrive

_IMPORT_FLAGS: Final = ("--watch", "--image", "--steering", "--steering-scale", "--columns")


@dataclass(frozen=True)
class Record:
    """Record a session to sessions/NAME.mcap: from the built-in simulator, a person, or a running simulator. For
    a recording of another program, there is bc-import.

    bc-record lake --track lake --laps 0.5
    bc-record mine --driver me --track lake --open
    bc-record live --listen --viewer
    """

    RARE: ClassVar[str] = "idle host port udacity page wander"
    REMOVED: ClassVar[Mapping[str, str]] = {
        **REMOVED_GYM_FLAGS,
        "--copy-to": "copy it with `bc-copy FROM s3://BUCKET/FOLDER`",
        **{flag: f"`bc-import SOURCE {flag}` has it" for flag in _IMPORT_FLAGS},
    }
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """Name of the session, without folder or ending."""
    listen: bool = False
    """Record a simulator that connects."""
    idle: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """End --listen after this long without data."""
    viewer: bool = False
    """Show --listen in Rerun."""
    host: str = "127.0.0.1"
    """Address for --listen; 0.0.0.0 admits other machines."""
    port: int = 4567
    """Port for --listen."""
    car: Annotated[str | None, tyro.conf.arg(metavar="udacity|built-in|FILE.toml")] = None
    """The car: steering angle, wheelbase, unit of speed; by default Udacity's."""
    rate: Annotated[float | None, tyro.conf.arg(metavar="HZ")] = None
    """Rows a second; built-in: 10 or another divisor of 50."""
    udacity: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Also write the simulated drive as a Udacity recording."""
    sessions: Path = Path("sessions")
    """Folder of the logs."""
    force: bool = False
    """Replace a session of the same name."""
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
    if any(word.partition("=")[0] == "--from" for word in sys.argv[1:]):  # of version 0.3
        from recorder.import_cli import import_for_record

        import_for_record(sys.argv[1:])
    run_command("bc-record", Record, _record)
