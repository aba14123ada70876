"""Keep results of measurements and supervised drives in their run, for `bc-runs`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from common import UserError
from common.command import DONE, warn
from drive.config import DriveConfig
from drive.drive_session import DriveSession
from model.errors import RunWriteError
from model.runs.kept_results import Way, keep_result
from model.runs.run_arguments import run_argument
from model.runs.run_folder import config_folder
from model.runs.runs_in_store import send_results


def keep(run: Path, way: Way, result: Mapping[str, Any]) -> int:
    """Keep a result in the run's folder, and in the store if the run is in one. A failure is only a warning.
    Returns exit code 3 if the result is not kept, or not in the store."""
    folder = config_folder(run)
    try:
        keep_result(run, way, result)
        send_results(folder)
    except RunWriteError as error:
        return warn(f"the result is not kept in the run: {error}")
    except (UserError, OSError) as error:
        later = f"the next `bc-eval` of {run_argument(folder)} on this machine sends it, too"
        return warn(f"the result is kept on this machine only ({error}); {later}")
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
