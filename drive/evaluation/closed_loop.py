"""Closed-loop evaluation: a network drives the built-in simulator on several tracks, at several speeds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from common.files import refuse_existing
from common.tasks import Tasks
from drive.config import DriveConfig
from drive.errors import DriveError
from drive.evaluation.simulator_process import BuiltInSimulator, drive_and_log
from model import Pilot, load_pilot
from model.config import Precision
from model.network.own_code import load_code
from model.runs.run_folder import run_name


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
    drives: Sequence[tuple[BuiltInSimulator, DriveConfig]],
    logs: Path,
    *,
    overwrite: bool = False,
    notify: Callable[[str], None] = lambda text: None,
) -> Iterator[DriveResult]:
    """Drive each simulator in lock-step, log that, and give the results as they come.

    `notify` gets a line before each drive. Raises DriveError where the simulator fails, UserError where a log
    exists and may not be overwritten.
    """
    paths = _log_paths(pilot.run, drives, logs, overwrite=overwrite)
    for (simulator, config), path in zip(drives, paths, strict=True):
        laps = f"{simulator.laps:g} lap{'' if simulator.laps == 1 else 's'}"
        notify(f"{pilot.run} on {simulator.track} at {config.set_speed_mph:g} mph, {laps}")
        report, _ = drive_and_log(pilot, simulator, config, path, overwrite=overwrite)
        yield DriveResult(simulator, config, path, report)


def drive_runs(
    runs: Sequence[tuple[Path, Path]],
    drives: Sequence[tuple[BuiltInSimulator, DriveConfig]],
    tasks: Tasks,
    *,
    networks: Sequence[str] = (),
    precision: Precision = "auto",
    overwrite: bool = False,
) -> Iterator[tuple[int, DriveResult]]:
    """Let each of some runs, each with the folder of its logs, make each of the drives; number and result of each,
    as they come. They are the numbers of `evaluate`.

    `networks` names the code that runs of one's own networks need. Raises what `evaluate` does.
    """
    calls = [
        (run, tuple(networks), precision, simulator, config, path)
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
    simulator: BuiltInSimulator,
    config: DriveConfig,
    log: Path,
) -> DriveResult:
    pilot = _warm_pilot(run, networks, precision)
    # whether it may be replaced was asked before: a drive that is made again may find the log of the first one
    report, _ = drive_and_log(pilot, simulator, config, log, overwrite=True, shows_progress=False)
    return DriveResult(simulator, config, log, report)


@lru_cache(maxsize=1)
def _warm_pilot(run: Path, networks: tuple[str, ...], precision: Precision) -> Pilot:
    """A process of a cluster makes many drives, most of them of one run."""
    for name in networks:
        load_code(name)
    pilot = load_pilot(run, precision)
    pilot.warm_up()
    return pilot


def _log_paths(
    run: str, drives: Sequence[tuple[BuiltInSimulator, DriveConfig]], logs: Path, *, overwrite: bool
) -> list[Path]:
    """The log of each drive; raised is before the first of them what would be after it."""
    paths = [logs / f"{run}-{simulator.name}-{config.set_speed_mph:g}mph.mcap" for simulator, config in drives]
    for path in paths:
        refuse_existing(path, overwrite)
    if len(set(paths)) < len(paths):
        raise DriveError("the same track at the same speed is named twice")
    return paths
