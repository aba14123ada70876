"""`bc-import`: makes a session of a recording that another program wrote."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from common.command import run_command
from recorder.sources.settings import ImportSettings


@dataclass(frozen=True)
class Import:
    """Import a recording of another program to sessions/NAME.mcap: a Udacity folder, a DonkeyCar tub, an .mcap, a
    ROS 2 bag, a LeRobot dataset, or pictures with a csv.

    bc-import ~/beta_simulator/recording
    bc-import ~/mycar/data track
    bc-import drive.mcap --image /camera/image/compressed --steering /cmd_vel.angular.z --steering-scale -1
    """

    RARE: ClassVar[str] = "idle viewer"
    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    """The folder or file of the recording."""
    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[NAME]")] = None
    """Name of the session, without folder or ending; by default the recording's."""
    settings: tyro.conf.OmitArgPrefixes[ImportSettings] = field(default_factory=ImportSettings)
    car: Annotated[str | None, tyro.conf.arg(metavar="udacity|built-in|FILE.toml")] = None
    """The car: steering angle, wheelbase, unit of speed; by default Udacity's."""
    watch: bool = False
    """Follow a Udacity folder as it is written."""
    idle: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """End --watch after this long without data."""
    viewer: bool = False
    """Show --watch in Rerun."""
    sessions: Path = Path("sessions")
    """Folder of the logs."""
    force: bool = False
    """Replace a session of the same name."""


def _import(config: Import) -> int:
    from recorder.import_command import import_session  # NumPy, Arrow, Protobuf, OpenCV

    return import_session(config)


def main() -> None:
    run_command("bc-import", Import, _import)


def import_for_record(words: Sequence[str]) -> None:
    """Run the words of an earlier `bc-record NAME --from SOURCE`, which contain --from, as `bc-import`."""
    words = [part for word in words for part in (word.split("=", 1) if word.startswith("--from=") else [word])]
    at = words.index("--from")
    sys.argv[1:] = [*words[at + 1 : at + 2], *words[:at], *words[at + 2 :]]

    def run(config: Import) -> int:
        import shlex

        from common.output import print_message

        print_message(f"bc-record --from is now `bc-import {shlex.join(sys.argv[1:])}`")
        return _import(config)

    run_command("bc-import", Import, run)
