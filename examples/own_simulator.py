"""A simulator of one's own in 60 lines: a winding road, one camera, and a driver to record.

With `bc-record listen mine` it drives itself; with `bc-drive mine` a network drives it.
"""

import math
from typing import Any

import cv2
import numpy as np

from simulator import SimulatorClient, SimulatorTelemetry, SteerCommand

STEP_S, SPEED_MPS, MAX_DEG, WHEELBASE_M, HALF_WIDTH_M, CAMERA_M = 0.05, 6.0, 30.0, 2.6, 2.5, 1.4
AHEAD_M = np.arange(1.9, 60.0, 0.5)


def road_y(x_m: Any) -> Any:  # the centre line goes east, and winds
    return 8.0 * np.cos(x_m / 20.0) + 4.0 * np.cos(x_m / 9.0)


class Car:
    def __init__(self, telemetries: int) -> None:
        self.x_m = self.heading_rad = self.time_s = self.steering = 0.0
        self.y_m, self.left = road_y(0.0), telemetries

    def next_telemetry(self, command: Any) -> SimulatorTelemetry | None:
        """After each answer: a SteerCommand, "manual" where the driving is ours, None at the beginning."""
        self.steering = command.steering if isinstance(command, SteerCommand) else self.expert()
        wheels_rad = math.radians(MAX_DEG) * np.clip(self.steering, -1, 1)  # positive steers to the right
        self.heading_rad -= STEP_S * SPEED_MPS / WHEELBASE_M * math.tan(wheels_rad)
        self.x_m += STEP_S * SPEED_MPS * math.cos(self.heading_rad)
        self.y_m += STEP_S * SPEED_MPS * math.sin(self.heading_rad)
        self.time_s, self.left = self.time_s + STEP_S, self.left - 1
        return self.telemetry() if self.left >= 0 else None  # None: quit

    def expert(self) -> float:  # towards the point of the centre line 6 m ahead
        angle_rad = math.atan2(road_y(self.x_m + 6.0) - self.y_m, 6.0) - self.heading_rad
        return float(np.clip(-math.degrees(math.atan2(WHEELBASE_M * math.sin(angle_rad), 3.0)) / MAX_DEG, -1, 1))

    def telemetry(self) -> SimulatorTelemetry:
        offset = (self.y_m - road_y(self.x_m)) / HALF_WIDTH_M
        pose = {"x_m": self.x_m, "y_m": self.y_m, "z_m": 0.0, "heading_rad": self.heading_rad, "pitch_rad": 0.0}
        world = {"time_s": self.time_s, **pose, "roll_rad": 0.0, "offset": offset, "interventions": 0}
        world["expert_steering"], world["expert_throttle"] = self.expert(), 0.2
        _, jpeg = cv2.imencode(".jpg", self.picture())
        return SimulatorTelemetry(self.steering, 0.2, SPEED_MPS / 0.44704, jpeg.tobytes(), world)

    def picture(self) -> Any:  # (160, 320, 3), BGR; the horizon at row 60, as Udacity's camera has it
        picture = np.full((160, 320, 3), (60, 110, 60), np.uint8)
        picture[:60] = (220, 180, 140)
        left_m = road_y(self.x_m + AHEAD_M) - self.y_m - AHEAD_M * math.tan(self.heading_rad)
        rows = 60 + 138 * CAMERA_M / AHEAD_M
        edges = [160 - 138 * (left_m + side * HALF_WIDTH_M) / AHEAD_M for side in (1, -1)]
        outline = np.concatenate([np.stack([edges[0], rows], 1), np.stack([edges[1], rows], 1)[::-1]])
        return cv2.fillPoly(picture, [outline.astype(np.int32)], (90, 90, 90))


if __name__ == "__main__":
    SimulatorClient(max_steering_deg=MAX_DEG, in_flight=1).run(Car(telemetries=1200).next_telemetry)
