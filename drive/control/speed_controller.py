"""The speed controller: proportional-integral with a bounded integral, and slower in curves if asked for."""

from __future__ import annotations

import math
from typing import Final

from common.car import MPS_PER_MPH
from drive.control.braking import WALKING_MPH
from simulator.driving.expert import BEND_MPS2
from simulator.driving.vehicle import MAX_WHEEL_RAD, WHEELBASE_M

KP: Final = 0.1  # throttle for each mph too slow
KI: Final = 0.002  # throttle for each mph too slow, summed over telemetries
MAX_INTEGRAL_THROTTLE: Final = 0.5  # without a bound, a long climb winds up a throttle that outlasts it


class SpeedController:
    """Gives the throttle for each telemetry's speed, as the original project's controller does."""

    def __init__(self, set_speed_mph: float, slow_in_curves: bool = False) -> None:
        self.set_speed_mph = set_speed_mph
        self._slow_in_curves = slow_in_curves
        self._integral = 0.0

    def set_speed_for(self, steering: float) -> float:
        """The set speed in mph while the steering is -1..1: lower in a curve, if that was asked for."""
        if not self._slow_in_curves:
            return self.set_speed_mph
        return min(self.set_speed_mph, max_curve_speed_mph(steering))

    def throttle(self, speed_mph: float, steering: float = 0.0) -> float:
        """-1 (full brake) .. 1 (full throttle); never below 0 at walking pace, where it would reverse the car."""
        set_speed_mph = self.set_speed_for(steering)
        error = set_speed_mph - speed_mph
        # What a curve takes off is no lasting error: summed up, it would be missing on the straight behind it.
        if set_speed_mph == self.set_speed_mph:
            bound = MAX_INTEGRAL_THROTTLE / KI
            self._integral = min(max(self._integral + error, -bound), bound)
        least = -1.0 if speed_mph > WALKING_MPH else 0.0
        return min(max(KP * error + KI * self._integral, least), 1.0)


def max_curve_speed_mph(steering: float) -> float:
    """The speed at which the wheels at this steering, -1..1, throw the car outwards by the expert's `BEND_MPS2`.

    The bicycle model without slip: the curvature is tan(wheel angle) / wheelbase, the acceleration v² times it.
    """
    curvature_per_m = math.tan(abs(steering) * MAX_WHEEL_RAD) / WHEELBASE_M
    return math.sqrt(BEND_MPS2 / curvature_per_m) / MPS_PER_MPH if curvature_per_m else math.inf
