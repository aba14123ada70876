"""A log of one's own robot: its picture and its steering, twenty times a second.

python examples/own_robot.py sessions/robot.mcap
bc-log check sessions/robot.mcap
"""

import sys
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import MPS_PER_MPH
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState

RATE_HZ, ROWS = 20, 100


class Robot:
    """A stand-in for yours: it follows a line on the floor that goes to and fro."""

    def __init__(self) -> None:
        self.frame = 0

    def picture(self) -> NDArray[np.uint8]:  # (height, width, 3), BGR
        self.frame += 1
        picture = np.random.default_rng(self.frame).integers(50, 70, (160, 320, 3), np.uint8)
        x = round(160 + 100 * self.steering())
        cv2.line(picture, (160, 160), (x, 60), (255, 255, 255), 12)
        return picture

    def steering(self) -> float:
        return float(np.sin(self.frame / 15))

    def speed_mps(self) -> float:
        return 1.5


def main(path: Path) -> None:
    robot, begun_ns = Robot(), time.time_ns()
    about = {"source": "my robot", "driver": "me"}
    # live: a crash, or a pulled plug, costs at most the last second
    with LogWriter(path, about, live=True) as log:
        for row in range(ROWS):
            time_ns = begun_ns + row * 1_000_000_000 // RATE_HZ
            time.sleep(max(0, time_ns - time.time_ns()) / 1e9)
            _, jpeg = cv2.imencode(".jpg", robot.picture())
            log.picture("center", time_ns, row, jpeg.tobytes())
            speed_mph = robot.speed_mps() / MPS_PER_MPH
            log.vehicle(time_ns, row, VehicleState(steering=robot.steering(), throttle=0.2, speed_mph=speed_mph))
        log.event(time_ns, "the battery is low", "WARNING")
    print(f"{path}: {ROWS} rows, {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
