"""The emergency brake: full brake exactly as long as the car needs to stop."""

from __future__ import annotations

import math
from typing import Final

from common.car import MPS_PER_MPH
from simulator.driving.vehicle import BRAKE_MPS2, TOP_SPEED_MPS, resistance_mps2

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
