"""`bc-record`: a drive becomes a log."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from common.command import run_command, warn_skipped
from recorder.errors import RecordingError
from recorder.record import import_udacity
from recorder.simulated import SimulatedDrive, record_simulated


@dataclass(frozen=True)
class Record:
    """Record a session to sessions/NAME.mcap: of the built-in simulator, or from a recording.

    bc-record lake --track lake --laps 0.5
    bc-record mine --from ~/beta_simulator/recording
    """

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """Name of the session: a plain name, without folders or ending."""
    source: Annotated[Path | None, tyro.conf.arg(name="from", metavar="FOLDER")] = None
    """A folder into which the Udacity simulator recorded: driving_log.csv and IMG/."""
    udacity: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Write the built-in simulator's drive also as the real one would, into this new folder."""
    sessions: Path = Path("sessions")
    """Where logs are kept."""
    force: bool = False
    """Replace a session of the same name."""
    drive: tyro.conf.OmitArgPrefixes[SimulatedDrive] = field(default_factory=SimulatedDrive)


def record(config: Record) -> int:
    name = config.name
    if not name or name.startswith(".") or any(character in name for character in '/\\\0\n\r:*?"<>|'):
        raise RecordingError(f"{name!r}: not a name for a session; give a plain one, such as `bc-record lake`")
    log = config.sessions / f"{name}.mcap"
    if config.source is not None:
        if config.udacity is not None or config.drive != SimulatedDrive():
            raise RecordingError(
                "--from imports a recording; --udacity and --track and its like are the simulator's"
            )
        done = import_udacity(config.source, log, overwrite=config.force)
    else:
        done = record_simulated(config.drive, log, udacity=config.udacity, overwrite=config.force)
    size_mb = done.path.stat().st_size / 1e6
    code = warn_skipped(done.skipped)
    print(f"{done.path}: {done.rows:,} rows, {done.pictures:,} pictures, {size_mb:.1f} MB")
    return code


def main() -> None:
    run_command("bc-record", Record, record)
