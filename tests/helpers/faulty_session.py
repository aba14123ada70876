"""A session with planted faults: steering that never changes, a crash, a gap in time, pictures that are frozen."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from common.car import Camera
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from tests.helpers.logs import START_NS

ROWS = 600
STUCK = (100, 149)  # the very same steering for five seconds of driving
STANDING = (300, 339)
CRASH = (290, 339)  # with its approach: the car stands at once
GAP_AT = 450  # five seconds pass before this row
FROZEN = (520, 539)  # the very same picture


def gray(row: int) -> bytes:
    """A picture as bright as its row says; no two are the same."""
    picture = np.full((16, 32), row * 255 // ROWS, np.uint8)
    picture[0, :2] = row // 256, row % 256
    ok, encoded = cv2.imencode(".png", picture)
    assert ok
    return encoded.tobytes()


def write_faulty(path: Path) -> None:
    time_ns = START_NS
    with LogWriter(path, {"source": "test"}) as writer:
        for row in range(ROWS):
            time_ns += 5_000_000_000 if row == GAP_AT else 100_000_000
            is_stuck = STUCK[0] <= row <= STUCK[1]
            steering = 0.25 if is_stuck else 0.3 * np.sin(row / 7)
            speed_mph = 0.0 if STANDING[0] <= row <= STANDING[1] else 20.0
            for camera in cameras():
                is_frozen = FROZEN[0] <= row <= FROZEN[1]
                writer.picture(camera, time_ns, row, gray(FROZEN[0] if is_frozen else row))
            writer.vehicle(
                time_ns, row, VehicleState(steering=steering, throttle=0.5, brake=0.0, speed_mph=speed_mph)
            )


def cameras() -> tuple[Camera, ...]:
    return "center", "left"
