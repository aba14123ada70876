"""Closed-loop evaluation: a network drives the built-in simulator on several tracks, at several speeds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.files import refuse_existing
from drive.config import DriveConfig
from drive.errors import DriveError
from drive.evaluation.simulator_process import BuiltInSimulator, drive_and_log
from model import Pilot


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
    paths = [_log_path(pilot, simulator, config, logs) for simulator, config in drives]
    for path in paths:  # before the first drive, not after it
        refuse_existing(path, overwrite)
    if len(set(paths)) < len(paths):
        raise DriveError("the same track at the same speed is named twice")
    for (simulator, config), path in zip(drives, paths, strict=True):
        laps = f"{simulator.laps:g} lap{'' if simulator.laps == 1 else 's'}"
        notify(f"{pilot.run} on {simulator.track} at {config.set_speed_mph:g} mph, {laps}")
        report, _ = drive_and_log(pilot, simulator, config, path, overwrite=overwrite)
        yield DriveResult(simulator, config, path, report)


def _log_path(pilot: Pilot, simulator: BuiltInSimulator, config: DriveConfig, logs: Path) -> Path:
    return logs / f"{pilot.run}-{simulator.name}-{config.set_speed_mph:g}mph.mcap"
