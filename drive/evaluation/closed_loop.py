"""Closed-loop evaluation: a network drives the built-in simulator on several tracks, at several speeds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from common.files import refuse_existing
from common.tasks import Tasks
from drive.config import DriveConfig
from drive.errors import DriveError
from drive.evaluation.simulator_process import BuiltInSimulator, drive_and_log
from model import Pilot, load_pilot
from model.config import Device, Precision
from model.network.own_code import load_code
from model.runs.run_folder import run_name

DRIVES: Final = Path("drives")
"""The default folder of the drives' logs."""


PlannedDrive = tuple[BuiltInSimulator, DriveConfig]


@dataclass(frozen=True)
class DriveResult:
    """The result of one drive, with the simulator's own report (an `AutonomousDrive`)."""

    simulator: BuiltInSimulator
    config: DriveConfig
    log: Path
    report: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        return {"set_speed_mph": self.config.set_speed_mph, "log": str(self.log), **self.report}


def evaluate(
    pilot: Pilot,
    drives: Sequence[PlannedDrive],
    logs: Path,
    *,
    overwrite: bool = False,
    notify: Callable[[str], None] = lambda text: None,
) -> Iterator[DriveResult]:
    """Drive each simulator in lock-step, log the drives, and yield each result when it is finished.

    `notify` gets a line before each drive. Raises DriveError if the simulator fails, UserError if a log exists and
    may not be overwritten.
    """
    paths = _log_paths(pilot.run, drives, logs, overwrite=overwrite)
    for (simulator, config), path in zip(drives, paths, strict=True):
        laps = f"{simulator.laps:g} lap{'' if simulator.laps == 1 else 's'}"
        notify(f"{pilot.run} on {simulator.track} at {config.set_speed_mph:g} mph, {laps}")
        report = drive_and_log(pilot, simulator, config, path, overwrite=overwrite)
        yield DriveResult(simulator, config, path, report)


def drive_runs(
    runs: Sequence[tuple[Path, Path]],
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
        (run, tuple(networks), precision, device, simulator, config, path, shows_progress)
        for run, logs in runs
        for (simulator, config), path in zip(
            drives, _log_paths(run_name(run), drives, logs, overwrite=overwrite), strict=True
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
    path: Path,
    shows_progress: bool,
) -> DriveResult:
    pilot = _warm_pilot(run, networks, precision, device)
    # `_log_paths` has checked for existing logs; a drive that the cluster repeats replaces its own first log
    report = drive_and_log(pilot, simulator, config, path, overwrite=True, shows_progress=shows_progress)
    return DriveResult(simulator, config, path, report)


@lru_cache(maxsize=1)
def _warm_pilot(run: Path, networks: tuple[str, ...], precision: Precision, device: Device) -> Pilot:
    """The pilot of a run, cached, because a process makes many drives, most of them of one run."""
    for name in networks:
        load_code(name)
    pilot = load_pilot(run, precision, device)
    pilot.warm_up()
    return pilot


def _log_paths(run: str, drives: Sequence[PlannedDrive], logs: Path, *, overwrite: bool) -> list[Path]:
    """The paths of the drives' logs. Raises, before the first drive, what a later drive would raise."""
    paths = [
        logs / f"{run}-{simulator.track.replace(':', '-')}-{config.set_speed_mph:g}mph.mcap"
        for simulator, config in drives
    ]
    for path in paths:
        refuse_existing(path, overwrite, "give --drives FOLDER for another place")
    if len(set(paths)) < len(paths):
        raise DriveError("the same track at the same speed is named twice")
    return paths
