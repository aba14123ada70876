"""Keep results of measurements and supervised drives in their run, for `bc-runs`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from common.command import DONE, warn
from drive.config import DriveConfig
from drive.drive_session import DriveSession
from model.errors import RunWriteError
from model.runs.kept_results import Way, keep_result


def keep(run: Path, way: Way, result: Mapping[str, Any]) -> int:
    """Keep a result in the run's folder. Returns exit code 3 and prints a warning if that fails."""
    try:
        keep_result(run, way, result)
    except RunWriteError as error:
        return warn(f"the result is not kept in the run: {error}")
    return DONE


def keep_supervised(run: Path, config: DriveConfig, track: str | None, session: DriveSession) -> int:
    """Keep the result of a drive that a person supervised, if its simulator reports laps. Returns the exit
    code."""
    summary = session.summary
    if summary.laps is None:
        return DONE
    result = {
        "track": track or "another simulator",  # which names no track
        "set_speed_mph": config.set_speed_mph,
        "laps": summary.laps,
        "distance_m": summary.distance_m,
        "interventions": summary.interventions,
        "by_person": summary.manual_stretches,
        "put_back": summary.put_back,
        "autonomy_percent": summary.autonomy_percent,
        "log": str(session.writer.path),
    }
    return keep(run, "supervised", result)
