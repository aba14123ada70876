"""The car that is driven: of the simulator that is known, named by `--car`, or that of the run's sessions."""

from __future__ import annotations

from pathlib import Path

from common.car import MAX_STEERING_DEG
from common.stored_settings import settings_from
from drive.errors import DriveError
from model.runs.car_of_run import cars_of_run, known_max_steering_deg_of_run, max_steering_deg_of_run
from recorder.log.session_car import UDACITY, Car, built_in, named_car


def driven_car(run: Path, named: str | None) -> Car | None:
    """The car that `named` names (see `named_car`), by default that of the run's sessions. None where that is
    Udacity's or the built-in simulator's: telemetry does not distinguish them, and their numbers are the same.

    Raises RunError as `load_config` does, RecordingError for a file that is none, DriveError for settings of a run
    that no car has.
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
    return None if car in (UDACITY, built_in()) else car


def other_steering(run: Path, car: Car | None) -> str:
    """A line about a run in which steering 1 is an unknown angle, or another one than in the car; else empty."""
    if known_max_steering_deg_of_run(run) is None:
        return f"{run} learnt from a car that does not say how far its wheels turn: its steering is sent as it is"
    learnt_deg, driven_deg = max_steering_deg_of_run(run), (car or UDACITY).max_steering_deg
    if learnt_deg == driven_deg:
        return ""
    return f"steering 1 is {learnt_deg:g} degrees in {run}, and {driven_deg:g} in this car: it is sent as it is"
