"""Small logs of two drives, with pictures that decode, for LeRobot datasets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import CAMERAS, Camera
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState

START_NS = 1_720_880_000_000_000_000
PAUSE_NS = 5_000_000_000
# no two steps are alike, as a simulator's are not
TIMES_NS = [START_NS + 100_000_000 * row + 1_234_567 * (row % 3) + PAUSE_NS * (row >= 8) for row in range(20)]
DRIVES = [range(8), range(8, 20)]


def steering(row: int) -> float:
    """With more digits than 32 bits hold."""
    return 0.8 * math.sin(row / 3)


def jpeg(camera: Camera, row: int, size: tuple[int, int] = (64, 32)) -> bytes:
    """A picture (width, height) of its own for every row and camera."""
    columns = np.linspace(0, 255, size[0]).astype(np.uint8)
    picture = np.zeros((size[1], size[0], 3), np.uint8)
    picture[..., 0] = columns
    picture[..., 1] = 10 * row
    picture[..., 2] = 80 * CAMERAS.index(camera)
    ok, encoded = cv2.imencode(".jpg", picture)
    assert ok
    return encoded.tobytes()


def decoded(picture: bytes) -> NDArray[np.float64]:
    image = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image.astype(np.float64)


def write_drives(
    path: Path,
    *,
    cameras: Sequence[Camera] = CAMERAS,
    times_ns: Sequence[int] = TIMES_NS,
    size: tuple[int, int] = (64, 32),
    speed_mph: float = 9.3,
    metadata: dict[str, str] | None = None,
) -> Path:
    """A log of two drives, 8 and 12 rows long."""
    with LogWriter(path, {"source": "test", **(metadata or {})}) as writer:
        for row, time_ns in enumerate(times_ns):
            for camera in cameras:
                writer.picture(camera, time_ns, row, jpeg(camera, row, size))
            state = VehicleState(steering=steering(row), throttle=0.1 * (row % 10), brake=0.0, speed_mph=speed_mph)
            writer.vehicle(time_ns, row, state)
    return path
