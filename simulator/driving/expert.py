"""The expert driver: pure pursuit of the centre line, at a speed that is safe for the bends ahead."""

from __future__ import annotations

import math

import numpy as np

from common.car import MPS_PER_MPH
from simulator.driving.course import Course
from simulator.driving.vehicle import (
    AXLE_TO_CENTRE_M,
    BRAKE_MPS2,
    MAX_WHEEL_RAD,
    STEERING_LAG_S,
    THROTTLE_MPS2,
    CarState,
    resistance_mps2,
    slope_mps2,
    wheel_angle_for,
)
from simulator.roads.centreline import Centreline, Floats

_WANDER_S = 1.0
_WANDER_LAG_S = 0.2


class Wandering:
    """Smooth noise, like wandering hands: an Ornstein-Uhlenbeck process through a first-order lag. `deviation` is
    its standard deviation; the same seed gives the same noise."""

    def __init__(self, deviation: float, seed: int) -> None:
        # The lag reduces the variance of the process. This factor restores the standard deviation.
        self._deviation = deviation * math.sqrt(1.0 + _WANDER_LAG_S / _WANDER_S)
        self._random = np.random.default_rng(seed)
        self._time_s = 0.0
        self._raw = 0.0
        self._smooth = 0.0

    def at(self, time_s: float) -> float:
        """The noise at a time, which must not be before that of the last call, except at the start of a drive."""
        if self._deviation == 0.0:
            return 0.0
        # If the time goes back, a new drive begins.
        passed_s = max(0.0, time_s - self._time_s)
        self._time_s = time_s
        keep = math.exp(-passed_s / _WANDER_S)
        spread = self._deviation * math.sqrt(1.0 - keep * keep)
        self._raw = keep * self._raw + spread * self._random.standard_normal()
        self._smooth += (self._raw - self._smooth) * (1.0 - math.exp(-passed_s / _WANDER_LAG_S))
        return self._smooth


# The distance to the goal point. A shorter distance would follow hairpins more exactly: this one cuts them by 0.15
# of the half width. But it would correct an offset with jerks. A network that imitates these with a delay weaves.
LOOK_AHEAD_M = 4.0
LOOK_AHEAD_S = 0.6

BEND_MPS2 = 2.5  # lateral acceleration of a brisk driver, a third of the grip; the rest is for corrections
SLOW_DOWN_MPS2 = 2.0  # planned braking
_CURVATURE_SPAN_M = 5.0  # the curvature is averaged over this length, so that a single uneven point has no effect
_SPEED_GAIN_PER_S = 1.5


class Expert:
    """Drives a course along its centre line.

    The expert drives at ``set_speed_mph``, and slower in bends. ``noise`` is the standard deviation of human-like
    noise in the steering (0: none; 0.03: a calm person), which depends on ``seed``: the same seed and course give
    the same drive. The distance to the goal point is ``LOOK_AHEAD_M`` plus the distance driven in
    ``look_ahead_s``: a driver that reacts late needs more.
    """

    def __init__(
        self,
        line: Centreline,
        set_speed_mph: float,
        noise: float = 0.0,
        seed: int = 0,
        look_ahead_s: float = LOOK_AHEAD_S,
    ) -> None:
        if set_speed_mph <= 0:
            raise ValueError(f"the set speed must be above 0 mph, not {set_speed_mph}")
        if noise < 0:
            raise ValueError(f"noise is a standard deviation, 0 or more, not {noise}")
        self._line = line
        self._look_ahead_s = look_ahead_s
        self._speed_mps: list[float] = plan_speed(line, set_speed_mph * MPS_PER_MPH).tolist()
        self._noise = Wandering(noise, seed)

    def control(self, course: Course) -> tuple[float, float]:
        """The command for the course's current state: steering -1 (left) .. 1 (right), throttle -1 .. 1."""
        steering = self._steer(course) + self._noise.at(course.time_s)
        point: int = round(course.arc_m / self._line.step_m)
        throttle = throttle_for(course, self._speed_mps[point % len(self._speed_mps)])
        return min(1.0, max(-1.0, steering)), throttle

    def _steer(self, course: Course) -> float:
        """Pure pursuit (Coulter 1992, CMU-RI-TR-92-01): follow the arc from the rear axle to the goal point."""
        x, y, direction = _predict_rear_axle(course.vehicle)
        speed = abs(course.vehicle.speed_mps)
        arc, _ = self._line.project(x, y, course.arc_m)
        goal = self._line.at(arc + LOOK_AHEAD_M + self._look_ahead_s * speed)
        dx, dy = goal.x_m - x, goal.y_m - y
        to_the_left = -dx * math.sin(direction) + dy * math.cos(direction)
        curvature = 2.0 * to_the_left / (dx * dx + dy * dy)
        return -wheel_angle_for(curvature, speed) / MAX_WHEEL_RAD


def throttle_for(course: Course, speed_mps: float) -> float:
    """The throttle, -1 .. 1, that brings the car to a speed, against resistance and slope."""
    speed = course.vehicle.speed_mps
    force = _SPEED_GAIN_PER_S * (speed_mps - speed) + resistance_mps2(speed, course.off_road)
    force += slope_mps2(course.line.at(course.arc_m).slope)
    # At walking pace, a negative throttle would reverse the car.
    if force < 0 and speed < 0.5:
        return 0.0
    return min(1.0, max(-1.0, force / (THROTTLE_MPS2 if force > 0 else BRAKE_MPS2)))


def plan_speed(line: Centreline, max_mps: float) -> Floats:
    """The maximum speed in m/s at each point of the line, (N,), from which the car can still slow down for all
    bends ahead.

    In a bend, v² = acceleration / curvature; before it, v² may be higher by 2 * braking * distance.
    """
    span = 2 * round(_CURVATURE_SPAN_M / line.step_m / 2) + 1
    curvature = np.mean([np.roll(line.curvature_per_m, k - span // 2) for k in range(span)], axis=0)
    allowed: Floats = np.minimum(max_mps * max_mps, BEND_MPS2 / np.maximum(np.abs(curvature), 1e-6))
    gain = 2.0 * SLOW_DOWN_MPS2 * line.step_m
    planned = allowed.copy()
    for k in range(1, math.ceil(min(len(allowed), max_mps * max_mps / gain))):  # at most a lap ahead
        planned = np.minimum(planned, np.roll(allowed, -k) + k * gain)
    speed: Floats = np.sqrt(planned)
    return speed


def _predict_rear_axle(car: CarState) -> tuple[float, float, float]:
    """The rear axle's place and direction of motion when a command given now takes effect: after the steering
    lag."""
    turn = car.yaw_rate_radps * STEERING_LAG_S
    middle = car.heading_rad + turn / 2 - car.rear_slip_rad
    way = car.speed_mps * STEERING_LAG_S
    x = car.x_m - AXLE_TO_CENTRE_M * math.cos(car.heading_rad) + way * math.cos(middle)
    y = car.y_m - AXLE_TO_CENTRE_M * math.sin(car.heading_rad) + way * math.sin(middle)
    return x, y, car.heading_rad + turn - car.rear_slip_rad
