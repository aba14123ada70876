"""The speed controller: proportional-integral for a set speed; by acceleration for a changing target speed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from common.car import MPS_PER_MPH
from recorder.log.session_car import Car
from recorder.teleop.pedals import WALKING_MPH
from simulator.driving.expert import BEND_MPS2
from simulator.driving.vehicle import BRAKE_MPS2, MAX_WHEEL_RAD, THROTTLE_MPS2, WHEELBASE_M, resistance_mps2

KP: Final = 0.1  # throttle for each mph too slow
KI: Final = 0.002  # throttle for each mph too slow, summed over messages
MAX_INTEGRAL_THROTTLE: Final = 0.5  # without a bound, the throttle of a long climb would outlast it

TARGET_AHEAD_S: Final = 0.5
SLOPE_NOTICED_S: Final = 0.5  # time constant
STEEPEST_MPS2: Final = MAX_INTEGRAL_THROTTLE * THROTTLE_MPS2  # the same bound as an acceleration: a slope of 27 %
_PUT_ELSEWHERE_MPS2: Final = 12.0  # no tyre changes the speed so fast: the car was put elsewhere
_UNKNOWN_AFTER_S: Final = 1.0  # after a longer pause, another driver may have set the throttle


class SpeedController:
    """Computes the throttle for the speed in each telemetry message.

    `throttle` holds the set speed, as the original project's controller does. `follow` brings the car to a target
    speed within `target_ahead_s`, but not above the set speed.
    """

    def __init__(
        self,
        set_speed_mph: float,
        slow_in_curves: bool = False,
        target_ahead_s: float = TARGET_AHEAD_S,
        car: Car | None = None,
    ) -> None:
        """`car` is the driven car, by default the built-in simulator's."""
        self.set_speed_mph = set_speed_mph
        self._slow_in_curves = slow_in_curves
        self._car = car
        self._integral = 0.0
        self._target_ahead_s = target_ahead_s
        self._slope_mps2 = 0.0  # missing acceleration, from gravity and other causes
        self._last: _Answered | None = None

    def set_speed_for(self, steering: float, target_mph: float = math.inf) -> float:
        """The speed in mph to drive: the set speed, or the target if that is lower; with `slow_in_curves`, less
        where the steering (-1..1) is far from straight."""
        speed_mph = min(self.set_speed_mph, max(target_mph, 0.0))
        return min(speed_mph, max_curve_speed_mph(steering, self._car)) if self._slow_in_curves else speed_mph

    def throttle(self, speed_mph: float, steering: float = 0.0) -> float:
        """-1 (full brake) .. 1 (full throttle); never below 0 at walking pace, where it would reverse the car."""
        set_speed_mph = self.set_speed_for(steering)
        error = set_speed_mph - speed_mph
        # In a curve, the lower set speed is not summed up: the sum would slow the car on the next straight.
        if set_speed_mph == self.set_speed_mph:
            bound = MAX_INTEGRAL_THROTTLE / KI
            self._integral = min(max(self._integral + error, -bound), bound)
        min_throttle = -1.0 if speed_mph > WALKING_MPH else 0.0
        return min(max(KP * error + KI * self._integral, min_throttle), 1.0)

    def follow(
        self, time_s: float, speed_mph: float, target_mph: float, steering: float = 0.0, max_throttle: float = 1.0
    ) -> float:
        """The throttle, -1 .. 1 as from `throttle`, for a target in mph that may change with each message; at most
        `max_throttle`.

        The wanted acceleration brings the car to its target in `target_ahead_s`. The throttle is the sum of this
        acceleration, resistances and slope, divided by the maximum acceleration of the engine or the brakes of the
        simulator's car. Telemetry has no slope: it is estimated from the missing acceleration. `time_s` must not
        go back; all numbers except the target must be finite.
        """
        speed_mps = speed_mph * MPS_PER_MPH
        if self._last is not None:
            self._notice_slope(time_s, speed_mps, self._last)
        wanted_mps2 = (self.set_speed_for(steering, target_mph) * MPS_PER_MPH - speed_mps) / self._target_ahead_s
        resistance = resistance_mps2(speed_mps)
        pull = wanted_mps2 + resistance + self._slope_mps2
        min_throttle = -1.0 if speed_mph > WALKING_MPH else 0.0
        throttle = min(max(min(pull / _full_mps2(pull), max_throttle), min_throttle), 1.0)
        self._last = _Answered(time_s, speed_mps, throttle * _full_mps2(throttle) - resistance)
        return throttle

    def _notice_slope(self, time_s: float, speed_mps: float, last: _Answered) -> None:
        passed_s = time_s - last.time_s
        if not 0.0 < passed_s < _UNKNOWN_AFTER_S:
            return
        measured_mps2 = (speed_mps - last.speed_mps) / passed_s
        if abs(measured_mps2) > _PUT_ELSEWHERE_MPS2:
            return
        missing_mps2 = last.level_mps2 - measured_mps2
        slope_mps2 = self._slope_mps2 - math.expm1(-passed_s / SLOPE_NOTICED_S) * (missing_mps2 - self._slope_mps2)
        self._slope_mps2 = min(max(slope_mps2, -STEEPEST_MPS2), STEEPEST_MPS2)


@dataclass(frozen=True, slots=True)
class _Answered:
    """The speed in a telemetry message, and the acceleration that its answer gives on level ground."""

    time_s: float
    speed_mps: float
    level_mps2: float


def _full_mps2(throttle: float) -> float:
    """The acceleration at full throttle; for a throttle below 0, the deceleration at full brake."""
    return THROTTLE_MPS2 if throttle > 0.0 else BRAKE_MPS2


def max_curve_speed_mph(steering: float, car: Car | None = None) -> float:
    """The speed at which the lateral acceleration at this steering, -1..1, is the expert's `BEND_MPS2`. `car` is
    by default the built-in simulator's.

    The bicycle model without slip: the curvature is tan(wheel angle) / wheelbase, the acceleration v² * curvature.
    """
    max_rad = MAX_WHEEL_RAD if car is None else math.radians(car.max_steering_deg)
    wheelbase_m = WHEELBASE_M if car is None else car.wheelbase_m
    curvature_per_m = math.tan(abs(steering) * max_rad) / wheelbase_m
    return math.sqrt(BEND_MPS2 / curvature_per_m) / MPS_PER_MPH if curvature_per_m else math.inf
