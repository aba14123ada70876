"""`bc-record`: a drive becomes a log."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from common.command import run_command, warn_skipped
from recorder.errors import RecordingError
from recorder.record import import_udacity


@dataclass(frozen=True)
class Record:
    """Record a session to sessions/NAME.mcap.

    bc-record lake --from ~/beta_simulator/recording
    """

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """Name of the session: a plain name, without folders or ending."""
    source: Annotated[Path, tyro.conf.arg(name="from", metavar="FOLDER")]
    """The folder into which the Udacity simulator recorded: driving_log.csv and IMG/."""
    sessions: Path = field(default=Path("sessions"))
    """Where logs are kept."""
    force: bool = False
    """Replace a session of the same name."""


def record(config: Record) -> int:
    name = config.name
    if not name or name.startswith(".") or any(character in name for character in '/\\\0\n\r:*?"<>|'):
        raise RecordingError(f"{name!r}: not a name for a session; give a plain one, such as `bc-record lake`")
    done = import_udacity(config.source, config.sessions / f"{name}.mcap", overwrite=config.force)
    size_mb = done.path.stat().st_size / 1e6
    code = warn_skipped(done.skipped)
    print(f"{done.path}: {done.rows:,} rows, {done.pictures:,} pictures, {size_mb:.1f} MB")
    return code


def main() -> None:
    run_command("bc-record", Record, record)
