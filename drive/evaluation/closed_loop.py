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
    """The folder of the drives' logs, and the folder in a store to which finished logs are copied, if any."""

    local: Path
    store: Url | None = None

    @classmethod
    def of(cls, place: Location) -> LogFolder:
        return cls(place) if isinstance(place, Path) else cls(DRIVES, place)

    def __truediv__(self, name: str) -> LogFolder:
        return LogFolder(self.local / name, None if self.store is None else self.store / name)

    def refuse_existing(self, name: str, overwrite: bool) -> None:
        """Raise UserError if the log exists and may not be overwritten; StoreError if the store fails."""
        refuse_existing(self.local / name, overwrite, "give --drives FOLDER for another place")
        if self.store is not None:
            refuse_taken_name(self.store / name, overwrite)

    def copy(self, name: str, overwrite: bool) -> tuple[Location, str]:
        """Copy a finished log to the store, if any. Returns its place, and the reason if the copy failed, else an
        empty string."""
        log = self.local / name
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
    problem: str = ""  # the reason if its log could not be copied to the store

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
    """Drive each simulator in lock-step, log the drives, and yield each result when it is finished. With `logs` in
    a store, a drive is logged in drives/ and copied when it is finished.

    `notify` gets a line before each drive. Raises DriveError if the simulator fails, UserError if a log exists and
    may not be overwritten.
    """
    folder = logs if isinstance(logs, LogFolder) else LogFolder.of(logs)
    names = _log_names(pilot.run, drives, folder, overwrite=overwrite)
    for (simulator, config), name in zip(drives, names, strict=True):
        laps = f"{simulator.laps:g} lap{'' if simulator.laps == 1 else 's'}"
        notify(f"{pilot.run} on {simulator.track} at {config.set_speed_mph:g} mph, {laps}")
        report = drive_and_log(pilot, simulator, config, folder.local / name, overwrite=overwrite)
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
    shows_progress: bool = False,
) -> Iterator[tuple[int, DriveResult]]:
    """Let each run, given with the folder of its logs, make each of the drives. Yields the number and the result
    of each drive when it is finished. The results are those of `evaluate`.

    `networks` names the code that runs of a user's own networks need. With `shows_progress`, each simulator draws
    a bar on the terminal. Raises what `evaluate` raises.
    """
    calls = [
        (run, tuple(networks), precision, device, simulator, config, logs, name, overwrite, shows_progress)
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
    shows_progress: bool,
) -> DriveResult:
    pilot = _warm_pilot(run, networks, precision, device)
    # `_log_names` has checked for existing logs; a drive that the cluster repeats replaces its own first log
    report = drive_and_log(
        pilot, simulator, config, logs.local / name, overwrite=True, shows_progress=shows_progress
    )
    place, problem = logs.copy(name, overwrite)
    return DriveResult(simulator, config, place, report, problem)


@lru_cache(maxsize=1)
def _warm_pilot(run: Path, networks: tuple[str, ...], precision: Precision, device: Device) -> Pilot:
    """The pilot of a run, cached, because a process makes many drives, most of them of one run."""
    for name in networks:
        load_code(name)
    pilot = load_pilot(run, precision, device)
    pilot.warm_up()
    return pilot


def _log_names(run: str, drives: Sequence[PlannedDrive], logs: LogFolder, *, overwrite: bool) -> list[str]:
    """The names of the drives' logs. Raises, before the first drive, what a later drive would raise."""
    names = [
        f"{run}-{simulator.track.replace(':', '-')}-{config.set_speed_mph:g}mph.mcap"
        for simulator, config in drives
    ]
    for name in names:
        logs.refuse_existing(name, overwrite)
    if len(set(names)) < len(names):
        raise DriveError("the same track at the same speed is named twice")
    return names
