"""The geometry of the cars that logs are of: where their cameras stand, and how they turn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final, Literal

import numpy as np

from common.car import Camera
from recorder.errors import RecordingError
from recorder.log import topics
from recorder.log.reader import Log

KnownCar = Literal["udacity", "built-in"]

Outline = tuple[tuple[float, float], ...]
"""The upper edge of the bonnet in a picture: (column, row) of its corners, of a picture 320 by 160."""

OUTLINE_PX: Final = (320, 160)  # columns and rows of the pictures that outlines are of


@dataclass(frozen=True)
class CarGeometry:
    """Pinhole cameras that look straight ahead and are turned down, on a car that turns as a bicycle does.

    Pictures of another size show the same part of the world: lengths in pictures are shares of their height.
    """

    focal: float  # share of the picture's height
    horizon: float  # row of the horizon of a level road, from the top, as a share of the picture's height
    height_m: float  # above the road
    forward_m: float  # ahead of the rear axle
    left_m: Mapping[Camera, float]  # of the car's middle
    bonnet: Mapping[Camera, Outline]  # the car's own, in the lowest rows of its pictures
    wheelbase_m: float
    lag_s: float  # until 63 % of a change of the steering that is recorded have become a change of direction


# Measured in published recordings of its three worlds: docs/driving-a-recording.md.
UDACITY: Final = CarGeometry(
    focal=0.866,  # of Unity's default field of view: 60 degrees, from top to bottom
    horizon=0.375,
    height_m=1.35,
    forward_m=2.0,
    left_m={"center": 0.0, "left": 0.85, "right": -0.85},
    bonnet={
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
    },
    wheelbase_m=3.0,
    lag_s=0.07,
)


@cache
def built_in() -> CarGeometry:
    """Of the built-in simulator, as it renders them."""
    from simulator.driving import vehicle
    from simulator.rendering import bonnet, camera  # loads the renderer

    columns, rows = OUTLINE_PX
    outlines: dict[Camera, Outline] = {}
    for name in camera.MOUNT_LEFT_M:
        is_bonnet = bonnet.draw_bonnet(name, columns, rows)[..., 3] > 0
        top = np.where(is_bonnet.any(axis=0), rows - len(is_bonnet) + is_bonnet.argmax(axis=0), rows)
        outlines[name] = tuple(enumerate(top.tolist()))
    return CarGeometry(
        focal=camera.FOCAL_PX / camera.HEIGHT_PX,
        horizon=0.5 + camera.FOCAL_PX / camera.HEIGHT_PX * float(np.tan(camera.MOUNT_PITCH_RAD)),
        height_m=camera.MOUNT_UP_M,
        forward_m=camera.MOUNT_FORWARD_M,
        left_m=dict(camera.MOUNT_LEFT_M),
        bonnet=outlines,
        wheelbase_m=vehicle.WHEELBASE_M,
        lag_s=vehicle.STEERING_LAG_S,
    )


def geometry_of(log: Log, car: KnownCar | Literal["auto"] = "auto") -> CarGeometry:
    """The geometry of the car that a log is of. Raises RecordingError where nothing tells which one it is."""
    if car == "auto":
        car = _told_by(log)
    return UDACITY if car == "udacity" else built_in()


def _told_by(log: Log) -> KnownCar:
    sessions = [log.metadata]
    if _is_merged(log.metadata):  # it has the metadata of each of its logs
        of_another = f"{topics.SESSION_METADATA} of "
        found = [session for name, session in log.all_metadata() if name.startswith(of_another)]
        sessions = [session for session in found if not _is_merged(session)]
    cars = {_car_of(session, bool(log.counts.get(topics.POSE))) for session in sessions}
    car = cars.pop() if len(cars) == 1 else None
    if car is None:
        raise RecordingError(
            f"{log.path}: nothing in it tells where its cameras stand; that is known of Udacity's simulator and of"
            " the built-in one"
        )
    return car


def _is_merged(session: Mapping[str, str]) -> bool:
    return session.get("source") == "merged"


def _car_of(session: Mapping[str, str], has_poses: bool) -> KnownCar | None:
    """By the metadata of a session."""
    if session.get("simulator") == "built-in":
        return "built-in"
    source = session.get("source")
    if source in ("drive", "telemetry"):  # the real simulator tells nobody where its car is
        return "built-in" if has_poses else "udacity"
    return "udacity" if source == "udacity" else None
