"""The pedals of a car that a person steers: the person's throttle, a held speed, or the brakes."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

from common.car import MPS_PER_MPH
from recorder.teleop.seat import Control
from simulator.driving.course import Course
from simulator.driving.expert import plan_speed, throttle_for
from simulator.driving.vehicle import TOP_SPEED_MPS

MAX_STANDING_MPH: Final = 0.5  # a slower car stands: more braking would reverse it
_STEP_MPH: Final = 0.5  # speeds are planned in these steps
_GAIN_PER_MPH: Final = 0.2  # full throttle at 5 mph below the held speed; drag is balanced at 0.5 mph below


class CoursePedals:
    """The pedals of a course's car. A held speed is lower in bends, as for the built-in drivers."""

    def __init__(self, course: Course) -> None:
        self._course = course
        self._planned = lru_cache(maxsize=32)(self._plan)

    def throttle(self, control: Control) -> float:
        """The throttle now, -1 .. 1; below 0 brakes."""
        speed_mps = self._course.vehicle.speed_mps
        if control.is_absent:
            return -1.0 if speed_mps > 0 else throttle_for(self._course, 0.0)
        if control.hold_mph is None:
            return control.throttle
        planned = self._planned(round(control.hold_mph / _STEP_MPH))
        point: int = round(self._course.arc_m / self._course.line.step_m)
        return throttle_for(self._course, planned[point % len(planned)])

    def _plan(self, steps: int) -> list[float]:
        mps = min(TOP_SPEED_MPS, steps * _STEP_MPH * MPS_PER_MPH)
        planned: list[float] = plan_speed(self._course.line, mps).tolist()
        return planned


def throttle_of_telemetry(control: Control, speed_mph: float) -> float:
    """The throttle, -1 .. 1, for a car that reports only its speed (NaN if it does not)."""
    if control.is_absent:
        return brake_of_telemetry(speed_mph)
    if control.hold_mph is None:
        return control.throttle
    if math.isnan(speed_mph):
        return 0.0
    throttle = _GAIN_PER_MPH * (control.hold_mph - speed_mph)
    return min(1.0, max(-1.0 if speed_mph > MAX_STANDING_MPH else 0.0, throttle))


def brake_of_telemetry(speed_mph: float) -> float:
    """The throttle that stops a car without reversing it."""
    return -1.0 if speed_mph > MAX_STANDING_MPH else 0.0
