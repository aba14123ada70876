"""The pedals of a car that a person steers: the person's throttle, a held speed, or the brakes; and the emergency
brake."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

from common.car import MPS_PER_MPH
from recorder.teleop.seat import Control
from simulator.driving.course import Course
from simulator.driving.expert import plan_speed, throttle_for
from simulator.driving.vehicle import BRAKE_MPS2, TOP_SPEED_MPS, resistance_mps2

STANDING_MPH: Final = 0.5  # a slower car stands: more braking would reverse it
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
        if control.hold_mph is None or control.throttle < 0.0:  # the brake comes first
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
    if control.hold_mph is None or control.throttle < 0.0:  # the brake comes first
        return control.throttle
    if math.isnan(speed_mph):
        return 0.0
    throttle = _GAIN_PER_MPH * (control.hold_mph - speed_mph)
    return min(1.0, max(-1.0 if speed_mph > STANDING_MPH else 0.0, throttle))


def brake_of_telemetry(speed_mph: float) -> float:
    """The throttle that stops a car without reversing it."""
    return -1.0 if speed_mph > STANDING_MPH else 0.0


WALKING_MPH: Final = 1.0
"""At this speed or below, the brake ends: a negative throttle would soon reverse the car."""


def stopping_s(speed_mph: float) -> float:
    """The seconds that a full brake takes to stop the car.

    The deceleration is that of the built-in simulator's car at this speed, from brakes and resistance: 6.5 m/s² at
    10 mph. Udacity's car brakes with locked wheels, at least as hard. The time is too short rather than too long:
    a car that still rolls slowly stops by itself. But both simulators repeat the last command for ever, and a
    negative throttle reverses a standing car.
    """
    speed_mps = min(max(speed_mph * MPS_PER_MPH, 0.0), TOP_SPEED_MPS)
    return speed_mps / (BRAKE_MPS2 + resistance_mps2(speed_mps))


class EmergencyBrake:
    """Full brake from the first `throttle()` until the car must stand; then throttle 0 until `release()`.

    The car stands when its speed is about 0, or after the time that the brakes need from the last known speed. If
    no speed is known, from the top speed; this reverses a standing car for two seconds. Only a new lowest speed
    extends the brake. A car that gets no slower, or that has stopped once, may be rolling backwards (Udacity's
    speed has no sign), and the brake would speed it up.
    """

    def __init__(self) -> None:
        self._until_s: float | None = None
        self._lowest_mph = math.inf

    @property
    def is_on(self) -> bool:
        """True from the first `throttle()` until `release()`."""
        return self._until_s is not None

    def throttle(self, time_s: float, speed_mph: float | None) -> float:
        """The throttle at `time_s`, -1 or 0. `speed_mph` is the last known speed; None if none is known."""
        known_mph = math.inf if speed_mph is None else speed_mph
        if self._until_s is None or (known_mph < self._lowest_mph and time_s < self._until_s):
            self._lowest_mph = known_mph
            self._until_s = time_s + stopping_s(known_mph)
        if known_mph <= WALKING_MPH:
            self._until_s = min(self._until_s, time_s)
        return -1.0 if time_s < self._until_s else 0.0

    def release(self) -> None:
        self._until_s = None
