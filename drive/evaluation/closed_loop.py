"""Closed-loop evaluation: a network drives the built-in simulator on several tracks, at several speeds."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from common import UserError
from common.files import refuse_existing
from common.location import Location, Url
from common.tasks import Tasks
from drive.config import DriveConfig
from drive.errors import DriveError
from drive.evaluation.simulator_process import BuiltInSimulator, drive_and_log
from model import Pilot, load_pilot
from model.config import Device, Precision
from model.network.own_code import load_code
from model.runs.run_folder import run_name
from recorder.log_copy_cli import refuse_taken_name

DRIVES: Final = Path("drives")
"""The default folder of the drives' logs."""


@dataclass(frozen=True)
class LogFolder:
    """The folder of the drives' logs, and the folder in a store, if any, that each log is copied to at the end."""

    here: Path
    store: Url | None = None

    @classmethod
    def of(cls, place: Location) -> LogFolder:
        return cls(place) if isinstance(place, Path) else cls(DRIVES, place)

    def __truediv__(self, name: str) -> LogFolder:
        return LogFolder(self.here / name, None if self.store is None else self.store / name)

    def refuse_existing(self, name: str, overwrite: bool) -> None:
        """Raise UserError, before anything is driven, for a log that is there already; StoreError."""
        refuse_existing(self.here / name, overwrite, "give --drives FOLDER for another place")
        if self.store is not None:
            refuse_taken_name(self.store / name, overwrite)

    def copy(self, name: str, overwrite: bool) -> tuple[Location, str]:
        """Copy a finished log; where it lies then, and why it is not copied, or empty."""
        log = self.here / name
        if self.store is None:
            return log, ""
        from recorder.upkeep.copy_log import copy_log  # obstore, an extra

        try:
            return copy_log(log, self.store / name, overwrite=overwrite).place, ""
        except (UserError, OSError) as error:
            copies = shlex.join(("bc-log", "copy", str(log), str(self.store)))
            return log, f"{log}: is not in {self.store} ({error}); `{copies}` copies it"


PlannedDrive = tuple[BuiltInSimulator, DriveConfig]


@dataclass(frozen=True)
class DriveResult:
    """The result of one drive, with the simulator's own report (an `AutonomousDrive`)."""

    simulator: BuiltInSimulator
    config: DriveConfig
    log: Location
    report: dict[str, Any]
    problem: str = ""  # why its log is not in the store where it belongs

    def as_dict(self) -> dict[str, Any]:
        return {"set_speed_mph": self.config.set_speed_mph, "log": str(self.log), **self.report}


def evaluate(
    pilot: Pilot,
    drives: Sequence[PlannedDrive],
    logs: Location | LogFolder,
    *,
    overwrite: bool = False,
    notify: Callable[[str], None] = lambda text: None,
) -> Iterator[DriveResult]:
    """Drive each simulator in lock-step, log that, and give the results as they come. With `logs` in a store, a
    drive is logged in drives/ and copied when it is finished.

    `notify` gets a line before each drive. Raises DriveError where the simulator fails, UserError where a log
    exists and may not be overwritten.
    """
    folder = logs if isinstance(logs, LogFolder) else LogFolder.of(logs)
    names = _log_names(pilot.run, drives, folder, overwrite=overwrite)
    for (simulator, config), name in zip(drives, names, strict=True):
        laps = f"{simulator.laps:g} lap{'' if simulator.laps == 1 else 's'}"
        notify(f"{pilot.run} on {simulator.track} at {config.set_speed_mph:g} mph, {laps}")
        report = drive_and_log(pilot, simulator, config, folder.here / name, overwrite=overwrite)
        place, problem = folder.copy(name, overwrite)
        yield DriveResult(simulator, config, place, report, problem)


def drive_runs(
    runs: Sequence[tuple[Path, LogFolder]],
    drives: Sequence[PlannedDrive],
    tasks: Tasks,
    *,
    networks: Sequence[str] = (),
    precision: Precision = "auto",
    device: Device = "auto",
    overwrite: bool = False,
) -> Iterator[tuple[int, DriveResult]]:
    """Let each of some runs, each with the folder of its logs, make each of the drives; number and result of each,
    as they come. They are the numbers of `evaluate`.

    `networks` names the code that runs of one's own networks need. Raises what `evaluate` does.
    """
    calls = [
        (run, tuple(networks), precision, device, simulator, config, logs, name, overwrite)
        for run, logs in runs
        for (simulator, config), name in zip(
            drives, _log_names(run_name(run), drives, logs, overwrite=overwrite), strict=True
        )
    ]
    yield from tasks(_drive_run, calls)


def _drive_run(
    run: Path,
    networks: tuple[str, ...],
    precision: Precision,
    device: Device,
    simulator: BuiltInSimulator,
    config: DriveConfig,
    logs: LogFolder,
    name: str,
    overwrite: bool,
) -> DriveResult:
    pilot = _warm_pilot(run, networks, precision, device)
    # whether it may be replaced was asked before: a drive that is made again may find the log of the first one
    report = drive_and_log(pilot, simulator, config, logs.here / name, overwrite=True, shows_progress=False)
    place, problem = logs.copy(name, overwrite)
    return DriveResult(simulator, config, place, report, problem)


@lru_cache(maxsize=1)
def _warm_pilot(run: Path, networks: tuple[str, ...], precision: Precision, device: Device) -> Pilot:
    """A process of a cluster makes many drives, most of them of one run."""
    for name in networks:
        load_code(name)
    pilot = load_pilot(run, precision, device)
    pilot.warm_up()
    return pilot


def _log_names(run: str, drives: Sequence[PlannedDrive], logs: LogFolder, *, overwrite: bool) -> list[str]:
    """The log of each drive; raised is before the first of them what would be after it."""
    names = [
        f"{run}-{simulator.track.replace(':', '-')}-{config.set_speed_mph:g}mph.mcap"
        for simulator, config in drives
    ]
    for name in names:
        logs.refuse_existing(name, overwrite)
    if len(set(names)) < len(names):
        raise DriveError("the same track at the same speed is named twice")
    return names
