"""`bc-index`: turns logs into frames and balanced samples."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from common.command import run_command
from common.location_flag import LocationFlag
from common.ray_flag import RayAddress
from common.recipe import recipe_given
from dataset.config import IndexConfig


@dataclass(frozen=True)
class Index:
    """Build the index of the logs: frames and balanced samples, as parquet.

    Only changed sessions are read again. Without --look, no picture is decoded.

    bc-index
    bc-index lake mountain --where "speed_mph > 5"
    bc-index export --lerobot datasets/driving
    """

    RARE: ClassVar[str] = "ray"
    REMOVED: ClassVar[Mapping[str, str]] = {
        "--viewpoints": "bc-train alters every picture in every epoch instead",
        "--figures": "bc-web shows the balance; samples.parquet has the numbers",
    }
    sessions: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[SESSION ...]")] = ()
    """Names of sessions, or paths; by default all."""
    folder: Annotated[LocationFlag, tyro.conf.arg(name="sessions")] = Path("sessions")
    """Folder of the logs."""
    index: Path = Path("index")
    """Folder of the index."""
    look: bool = False
    """Decode all pictures; flag broken and frozen ones, and those that contradict the steering."""
    check: bool = False
    """Check the split for leaks; exit code 1 if there is one."""
    ray: RayAddress = None
    """Read the logs on a Ray cluster with shared folders."""
    config: tyro.conf.OmitArgPrefixes[IndexConfig] = field(default_factory=IndexConfig)


def _index(config: Index) -> int:
    from dataset.index_command import index  # imports NumPy, Arrow and OpenCV, which are slow to load

    return index(config)


def main() -> None:
    if sys.argv[1:2] == ["export"]:
        from dataset.index_export_cli import main as export

        export()
    run_command("bc-index", Index, _index, default=lambda: Index(config=IndexConfig.of(recipe_given())))
