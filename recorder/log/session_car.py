"""The car of a session: its steering, the positions of its cameras, the unit of its simulator's speeds.

These are settings of a session, kept in its log; the defaults are those of Udacity's simulator.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Final, Literal

import numpy as np

from common.car import MAX_STEERING_DEG, MPS_PER_MPH, Camera
from common.errors import printable
from common.location import Location
from common.stored_settings import read_toml, settings_from
from recorder import topics
from recorder.errors import LogError, RecordingError
from recorder.log.reader import Log

Outline = tuple[tuple[float, float], ...]
"""The upper edge of the bonnet in a picture: (column, row) of its corners from left to right, of a picture 320 by
160."""

_OF_UNKNOWN_CARS: Final = ("donkeycar", "csv", "mcap", "ros2 bag", "lerobot", "gymnasium")
"""Sources whose sessions do not say how far the wheels turn, unless they have a car."""

_OUTLINE_PX: Final = (320, 160)  # columns and rows of the pictures that outlines are of

CAR_KEY: Final = "car"  # of a car in a log's metadata: JSON

SpeedUnit = Literal["mph", "km/h", "m/s"]
MPH_OF: Final[Mapping[SpeedUnit, float]] = {"mph": 1.0, "km/h": 1 / 3.6 / MPS_PER_MPH, "m/s": 1 / MPS_PER_MPH}

_MAX_CORNERS: Final = 1000

# Measured in published recordings of Udacity's three worlds: docs/studies/warped-pictures.md.
_LEFT_M: Final[Mapping[Camera, float]] = {"center": 0.0, "left": 0.85, "right": -0.85}
_BONNET: Final[Mapping[Camera, Outline]] = {
    "center": (
        (36, 160),
        (60, 150),
        (84, 147),
        (106, 143),
        (122, 139),
        (138, 135),
        (172, 135),
        (188, 139),
        (206, 143),
        (240, 150),
        (262, 156),
        (268, 160),
    ),
    "left": ((182, 160), (187, 152), (199, 145), (213, 141), (240, 137), (262, 135), (285, 134), (320, 134)),
    "right": ((0, 133), (35, 133), (55, 136), (80, 139), (98, 143), (112, 146), (123, 152), (126, 160)),
}


@dataclass(frozen=True)
class Car:
    """Pinhole cameras that look straight ahead and are turned down, on a car that turns as a bicycle does. By
    default Udacity's.

    Pictures of another size show the same part of the world: lengths in pictures are shares of their height.
    """

    max_steering_deg: float = MAX_STEERING_DEG  # how far the front wheels turn at steering 1
    wheelbase_m: float = 3.0
    lag_s: float = 0.07  # until 63 % of a change of the recorded steering have become a change of direction
    speed_unit: SpeedUnit = "mph"  # of its simulator's speeds; logs hold mph
    focal: float = 0.866  # share of the picture's height; of Unity's field of view: 60 degrees, top to bottom
    horizon: float = 0.375  # row of the horizon of a level road, from the top, as a share of the picture's height
    height_m: float = 1.35  # of the cameras above the road
    forward_m: float = 2.0  # of the cameras ahead of the rear axle
    left_m: Mapping[Camera, float] = field(default_factory=lambda: dict(_LEFT_M))  # of the car's middle
    bonnet: Mapping[Camera, Outline] = field(default_factory=lambda: dict(_BONNET))  # in the lowest rows

    def __post_init__(self) -> None:
        """Raises ValueError, which names the setting, for a value that no car has."""
        expected = (
            ("max_steering_deg", self.max_steering_deg, 0.1 <= self.max_steering_deg < 90, "0.1 to less than 90"),
            ("wheelbase_m", self.wheelbase_m, 0.01 <= self.wheelbase_m <= 100, "0.01 to 100"),
            ("lag_s", self.lag_s, 0 <= self.lag_s <= 10, "0 to 10"),
            ("focal", self.focal, 0.05 <= self.focal <= 50, "0.05 to 50"),
            ("horizon", self.horizon, -5 <= self.horizon <= 5, "-5 to 5"),
            ("height_m", self.height_m, 0.01 <= self.height_m <= 100, "0.01 to 100"),
            ("forward_m", self.forward_m, -100 <= self.forward_m <= 100, "-100 to 100"),
            *((f"left_m of {name}", at, -100 <= at <= 100, "-100 to 100") for name, at in self.left_m.items()),
        )
        for name, value, holds, what in expected:  # a comparison with NaN is false
            if not holds:
                raise ValueError(f"{name} {value:g}: expected {what}")
        for name, outline in self.bonnet.items():
            corners = np.array(outline, np.float64).reshape(-1, 2)
            if (
                len(corners) > _MAX_CORNERS
                or not (np.abs(corners) < 1e4).all()
                or (np.diff(corners[:, 0]) < 0).any()
            ):
                raise ValueError(
                    f"bonnet of {name}: corners from left to right, {_MAX_CORNERS:,} at most, expected"
                )
        object.__setattr__(self, "left_m", {**_LEFT_M, **self.left_m})

    @property
    def max_wheel_rad(self) -> float:
        return math.radians(self.max_steering_deg)

    @property
    def mph(self) -> float:
        """The mph of one of its simulator's units of speed."""
        return MPH_OF[self.speed_unit]


UDACITY: Final = Car()


@cache
def built_in() -> Car:
    """The built-in simulator's car, with cameras as it renders them."""
    from simulator.driving import vehicle
    from simulator.rendering import bonnet, camera  # loads the renderer

    columns, rows = _OUTLINE_PX
    outlines: dict[Camera, Outline] = {}
    for name in camera.MOUNT_LEFT_M:
        is_bonnet = bonnet.draw_bonnet(name, columns, rows)[..., 3] > 0
        top = np.where(is_bonnet.any(axis=0), rows - len(is_bonnet) + is_bonnet.argmax(axis=0), rows)
        outlines[name] = _corners(top.tolist())
    return Car(
        max_steering_deg=math.degrees(vehicle.MAX_WHEEL_RAD),
        focal=camera.FOCAL_PX / camera.HEIGHT_PX,
        horizon=0.5 + camera.FOCAL_PX / camera.HEIGHT_PX * float(np.tan(camera.MOUNT_PITCH_RAD)),
        height_m=camera.MOUNT_UP_M,
        forward_m=camera.MOUNT_FORWARD_M,
        left_m=dict(camera.MOUNT_LEFT_M),
        bonnet=outlines,
        wheelbase_m=vehicle.WHEELBASE_M,
        lag_s=vehicle.STEERING_LAG_S,
    )


def _corners(heights: Sequence[int]) -> Outline:
    """The corners of a line through a point at every column."""
    last = len(heights) - 1
    return tuple(
        (column, row)
        for column, row in enumerate(heights)
        if column in (0, last) or heights[column - 1] != row or heights[column + 1] != row
    )


def metadata_of(car: Car | None) -> dict[str, str]:
    """The entry of a car in a log's `bc.session`; empty for None."""
    return {} if car is None else {CAR_KEY: json.dumps(asdict(car))}


def named_car(name: str) -> Car:
    """The car that `udacity`, `built-in` or the path of a TOML file with settings of `Car` names.

    Raises RecordingError for a file that is not there, or has other settings.
    """
    if name == "udacity":
        return UDACITY
    if name == "built-in":
        return built_in()
    try:
        return settings_from(Car, read_toml(name))
    except FileNotFoundError:
        hint = "udacity, built-in or a file of the car's settings was expected"
        raise RecordingError(f"--car {printable(name)}: no such file; {hint}") from None
    except (OSError, ValueError) as error:
        raise RecordingError(f"--car {printable(name)}: {printable(' '.join(str(error).split()))}") from None


def stored_car(log: Log) -> Car | None:
    """The car that is stored in a log; None if there is none, as in those of earlier versions, or several.

    Raises LogError for settings that no car has.
    """
    cars = [car_in(session, log.path) for session in _sessions(log)]
    return cars[0] if cars and all(car == cars[0] for car in cars) else None


def max_steering_deg_of(log: Log) -> float:
    """The angle of the front wheels at steering 1; Udacity's if the log has none: see `known_max_steering_deg`.

    Raises LogError for a merged log whose sessions differ in it, and for settings that no car has.
    """
    cars = (car_in(session, log.path) or UDACITY for session in _sessions(log))
    angles_deg = {car.max_steering_deg for car in cars} or {MAX_STEERING_DEG}
    if len(angles_deg) > 1:
        degrees = " and ".join(f"{angle:g}" for angle in sorted(angles_deg))
        raise LogError(f"{log.path}: merged of sessions whose wheels turn by {degrees} degrees at steering 1")
    return angles_deg.pop()


def known_max_steering_deg(log: Log) -> float | None:
    """`max_steering_deg_of`; None for a session of others' data that does not say it."""
    degrees = max_steering_deg_of(log)
    return None if any(map(is_angle_unknown, _sessions(log))) else degrees


def is_angle_unknown(session: Mapping[str, str]) -> bool:
    """Whether the metadata of a session, or of predictions for one, do not say how far the wheels turn."""
    return CAR_KEY not in session and session.get("log_source", session.get("source")) in _OF_UNKNOWN_CARS


def foreign_source(log: Log) -> str:
    """The source of a log of others' data, such as a tub; of a merged one, if all of its logs have it. Else
    empty."""
    sources = {session.get("log_source", session.get("source", "")) for session in _sessions(log)}
    source = sources.pop() if len(sources) == 1 else ""
    return source if source in _OF_UNKNOWN_CARS else ""


def car_of(log: Log) -> Car:
    """The car that a log is of.

    Raises RecordingError if it is unknown, LogError for settings that no car has.
    """
    has_poses = bool(log.counts.get(topics.POSE))
    cars = [car_in(session, log.path) or _implied(session, has_poses) for session in _sessions(log)]
    if not cars or cars[0] is None or any(other != cars[0] for other in cars):
        raise RecordingError(
            f"{log.path}: it does not describe its cameras. They are known for Udacity's simulator,"
            " the built-in one, and sessions that were recorded with --car"
        )
    return cars[0]


def _sessions(log: Log) -> list[dict[str, str]]:
    """The metadata of a log; of a merged one, that of each of its logs."""
    if not _is_merged(log.metadata):
        return [log.metadata]
    of_another = f"{topics.SESSION_METADATA} of "
    sessions = [session for name, session in log.all_metadata() if name.startswith(of_another)]
    return [session for session in sessions if not _is_merged(session)]


def _is_merged(session: Mapping[str, str]) -> bool:
    return session.get("source") == "merged"


def car_in(session: Mapping[str, str], where: Location) -> Car | None:
    """The car in the metadata of a session, from the log at `where`; None if there is none.

    Raises LogError for settings that no car has.
    """
    if CAR_KEY not in session:
        return None
    try:
        return settings_from(Car, json.loads(session[CAR_KEY]))
    except (ValueError, RecursionError) as error:
        why = printable(" ".join(str(error).split()))
        raise LogError(f"{where}: its car's settings cannot be used ({why})") from None


def _implied(session: Mapping[str, str], has_poses: bool) -> Car | None:
    """The car by a session's source, for logs of earlier versions."""
    if session.get("simulator") == "built-in":
        return built_in()
    source = session.get("source")
    if source in ("drive", "telemetry"):  # the real simulator does not send its car's place
        return built_in() if has_poses else UDACITY
    return UDACITY if source == "udacity" else None
