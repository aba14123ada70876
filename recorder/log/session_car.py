"""The car of a session: its steering, its wheelbase, and the unit of its simulator's speeds.

A session's log keeps these settings. The defaults are those of Udacity's simulator.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Final, Literal

from common.car import BUILT_IN_WHEELBASE_M, MAX_STEERING_DEG, MPS_PER_MPH
from common.errors import printable
from common.location import Location
from common.stored_settings import settings_from, settings_of_file
from recorder import topics
from recorder.errors import LogError, RecordingError
from recorder.log.reader import Log

_OF_UNKNOWN_CARS: Final = ("donkeycar", "csv", "mcap", "ros2 bag", "lerobot", "gymnasium")
"""Sources whose sessions only have the wheels' largest angle if they have a car."""

CAR_KEY: Final = "car"  # of a car in a log's metadata, as JSON

SpeedUnit = Literal["mph", "km/h", "m/s"]
MPH_OF: Final[Mapping[SpeedUnit, float]] = {"mph": 1.0, "km/h": 1 / 3.6 / MPS_PER_MPH, "m/s": 1 / MPS_PER_MPH}


@dataclass(frozen=True)
class Car:
    """A car that turns like a bicycle; by default Udacity's."""

    EARLIER_ONLY: ClassVar[Mapping[str, Any]] = dict.fromkeys(
        ("lag_s", "focal", "horizon", "height_m", "forward_m", "left_m", "bonnet"), ...
    )
    max_steering_deg: float = MAX_STEERING_DEG  # angle of the front wheels at steering 1
    wheelbase_m: float = 3.0  # Udacity's: docs/studies/warped-pictures.md
    speed_unit: SpeedUnit = "mph"  # of its simulator's speeds; logs hold mph

    def __post_init__(self) -> None:
        """Raises ValueError, which names the setting, for an impossible value."""
        if not 0.1 <= self.max_steering_deg < 90:  # a comparison with NaN is false
            raise ValueError(f"max_steering_deg {self.max_steering_deg:g}: expected 0.1 to less than 90")
        if not 0.01 <= self.wheelbase_m <= 100:
            raise ValueError(f"wheelbase_m {self.wheelbase_m:g}: expected 0.01 to 100")

    @property
    def mph(self) -> float:
        """One of its simulator's units of speed, in mph."""
        return MPH_OF[self.speed_unit]


UDACITY: Final = Car()
BUILT_IN: Final = Car(wheelbase_m=BUILT_IN_WHEELBASE_M)
"""The built-in simulator's car."""


def metadata_of(car: Car | None) -> dict[str, str]:
    """A car's entry in a log's `bc.session`; empty for None."""
    return {} if car is None else {CAR_KEY: json.dumps(asdict(car))}


def named_car(name: str) -> Car:
    """The car with a name: `udacity`, `built-in`, or the path of a TOML file with settings of `Car`.

    Raises RecordingError for a file that cannot be read, or has unknown or impossible settings.
    """
    if name == "udacity":
        return UDACITY
    if name == "built-in":
        return BUILT_IN
    try:
        return settings_of_file(Car, name)
    except ValueError as error:
        hint = "" if name.endswith(".toml") else "; expected udacity, built-in or FILE.toml"
        raise RecordingError(f"--car {printable(name)}: {error}{hint}") from None


def stored_car(log: Log) -> Car | None:
    """The car in a log; None if there is none, as in logs of earlier versions, or several.

    Raises LogError for impossible settings.
    """
    cars = [car_in(session, log.path) for session in _sessions(log)]
    return cars[0] if cars and all(car == cars[0] for car in cars) else None


def max_steering_deg_of(log: Log) -> float:
    """The angle of the front wheels at steering 1; Udacity's if the log has none (see `known_max_steering_deg`).

    Raises LogError for a merged log with different angles, and for impossible settings.
    """
    cars = (car_in(session, log.path) or UDACITY for session in _sessions(log))
    angles_deg = {car.max_steering_deg for car in cars} or {MAX_STEERING_DEG}
    if len(angles_deg) > 1:
        degrees = " and ".join(f"{angle:g}" for angle in sorted(angles_deg))
        raise LogError(f"{log.path}: merged of sessions whose wheels turn by {degrees} degrees at steering 1")
    return angles_deg.pop()


def known_max_steering_deg(log: Log) -> float | None:
    """`max_steering_deg_of`; None for an imported session without the angle."""
    degrees = max_steering_deg_of(log)
    return None if any(map(is_angle_unknown, _sessions(log))) else degrees


def is_angle_unknown(session: Mapping[str, str]) -> bool:
    """True if the metadata of a session, or of predictions for one, do not have the wheels' largest angle."""
    return CAR_KEY not in session and session.get("log_source", session.get("source")) in _OF_UNKNOWN_CARS


def foreign_source(log: Log) -> str:
    """The source of a log of other people's data, such as a tub, or of a log merged from these; empty for other
    logs."""
    sources = {session.get("log_source", session.get("source", "")) for session in _sessions(log)}
    source = sources.pop() if len(sources) == 1 else ""
    return source if source in _OF_UNKNOWN_CARS else ""


def _sessions(log: Log) -> list[dict[str, str]]:
    """The metadata of a log; for a merged log, of each of its logs."""
    if not _is_merged(log.metadata):
        return [log.metadata]
    of_another = f"{topics.SESSION_METADATA} of "
    sessions = [session for name, session in log.all_metadata if name.startswith(of_another)]
    return [session for session in sessions if not _is_merged(session)]


def _is_merged(session: Mapping[str, str]) -> bool:
    return session.get("source") == "merged"


def car_in(session: Mapping[str, str], where: Location) -> Car | None:
    """The car in the metadata of a session, from the log at `where`; None without one. Raises LogError for
    impossible settings."""
    if CAR_KEY not in session:
        return None
    try:
        return settings_from(Car, json.loads(session[CAR_KEY]))
    except (ValueError, RecursionError) as error:
        why = printable(" ".join(str(error).split()))
        raise LogError(f"{where}: its car's settings cannot be used ({why})") from None
