"""The driven car: named by `--car`, or the car of the run's sessions. The results of drives that a run keeps."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from common.car import MAX_STEERING_DEG
from common.command import DONE, warn
from common.stored_settings import settings_from
from drive.config import DriveConfig, DriveError
from drive.drive_session import DriveSession
from model.errors import RunWriteError
from model.runs.car_of_run import cars_of_run, known_max_steering_deg_of_run, max_steering_deg_of_run
from model.runs.run_files import Way, keep_result
from recorder.log.session_car import BUILT_IN, UDACITY, Car, named_car


def driven_car(run: Path, named: str | None) -> Car | None:
    """The car that `named` names (see `named_car`), by default the car of the run's sessions. None if that is
    Udacity's or the built-in simulator's: telemetry does not distinguish them, and their numbers are the same.

    Raises RunError as `load_config` does, RecordingError for a file that describes no car, DriveError for invalid
    car settings in a run.
    """
    if named is not None:
        return named_car(named)
    try:
        cars = {None if stored is None else settings_from(Car, stored) for stored in cars_of_run(run)}
    except ValueError as error:
        raise DriveError(f"{run}: the car in its config.json cannot be used ({error})") from None
    car = cars.pop() if len(cars) == 1 else None
    if car is None and (degrees := max_steering_deg_of_run(run)) != MAX_STEERING_DEG:
        return Car(max_steering_deg=degrees)
    return None if car in (UDACITY, BUILT_IN) else car


def other_steering(run: Path, car: Car | None) -> str:
    """A line if steering 1 of the run is an unknown angle, or another angle than in the car; else empty."""
    if known_max_steering_deg_of_run(run) is None:
        return f"{run} learnt from a car whose largest wheel angle is unknown: its steering is sent unchanged"
    learnt_deg, driven_deg = max_steering_deg_of_run(run), (car or UDACITY).max_steering_deg
    if learnt_deg == driven_deg:
        return ""
    return f"steering 1 is {learnt_deg:g} degrees in {run}, and {driven_deg:g} in this car: it is sent unchanged"


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
