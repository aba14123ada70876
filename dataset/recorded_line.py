"""The line that a recorded car drove, and a car that is steered beside it.

A car beside the line is where it is from the line, and how far it is turned from the line's direction: nothing has
to be known of where in the world the line lies, and no error of its course adds up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.car import MPS_PER_MPH
from recorder.log.session_car import Car
from recorder.rows.row_quality import GAP_S, States, row_flags

SLOW_MPH: Final = 5.0
"""Slower than this, people set off, or manoeuvre at walls with the wheels turned to their stop."""
HIT_MPS2: Final = 10.0
"""A loss of speed that no brakes cause: tyres give 8 on a dry road."""
AROUND_HIT_S: Final = 1.0
SHORTEST_S: Final = 2.0  # no network can leave the line before
_STEP_S: Final = 0.02
_MAX_TURN_RAD: Final = math.radians(45.0)

Values = NDArray[np.float64]


@dataclass(frozen=True)
class DrivableStretch:
    """Rows of a log, one after the other, that are driven without a border between them."""

    first: int
    end: int


def stretches_to_drive(states: States, is_usable: NDArray[np.bool_]) -> list[DrivableStretch]:
    """The stretches of a log's rows between its borders.

    Borders are gaps in time, time that goes backwards, rows that are not `is_usable` (N,), such as those without a
    picture, or have numbers that cannot be, rows slower than `SLOW_MPH`, of a crash or backwards, and the second
    before and after the car hits something. What is shorter than `SHORTEST_S` is left out.
    """
    if not len(states.row):
        return []
    flags = row_flags(states)
    speed = states.speed_mph
    is_good = is_usable & ~flags["out_of_range"] & ~flags["crash"] & ~flags["backwards"]
    is_good &= speed >= SLOW_MPH  # False if not known
    time_s = (states.time_ns - states.time_ns[0]) / 1e9
    step_s = np.diff(time_s)
    lost_mps = -np.diff(speed) * MPS_PER_MPH
    is_next = (step_s > 0) & (step_s <= GAP_S)
    for hit in np.flatnonzero(is_next & (lost_mps > HIT_MPS2 * step_s) & (lost_mps > HIT_MPS2 * 0.1)):
        is_good &= np.abs(time_s - time_s[hit]) > AROUND_HIT_S
    edges = np.flatnonzero(~(is_next & is_good[1:] & is_good[:-1])) + 1
    found = [
        DrivableStretch(*pair) for pair in zip([0, *edges.tolist()], [*edges.tolist(), len(speed)], strict=True)
    ]
    return [
        each for each in found if is_good[each.first] and time_s[each.end - 1] - time_s[each.first] >= SHORTEST_S
    ]


def curvature(steering: float, car: Car) -> float:
    """The curvature of the rear axle's way at a steering of -1 (left) .. 1 (right), in 1/m, positive to the left:
    that of the kinematic bicycle (Rajamani, Vehicle Dynamics and Control, section 2.2)."""
    return -math.tan(car.max_wheel_rad * steering) / car.wheelbase_m


@dataclass
class CarBesideLine:
    """A car that keeps abreast of the recorded one, beside its line. To the left is positive."""

    geometry: Car
    left_m: float = 0.0
    turn_rad: float = 0.0
    _recorded: float = 0.0  # curvatures, behind the lag of the steering
    _own: float = 0.0

    def put_on_line(self, steering: float) -> None:
        """Put the car where the recorded one is, which has been steered by `steering`."""
        self.left_m = self.turn_rad = 0.0
        self._recorded = self._own = curvature(steering, self.geometry)

    def follow(self, steering: float, recorded: float, speed_mps: tuple[float, float], seconds: float) -> None:
        """Hold `steering` for `seconds`, while the recorded car drives on with its steering `recorded`, from one
        speed to another.

        Both are held alike: with the recorded steering the car stays on the line, however far rows are apart. It
        is as fast as it must be to stay abreast, and is turned by 45 degrees at most.
        """
        steps = max(1, math.ceil(seconds / _STEP_S))
        step_s = seconds / steps
        share = 1.0 - math.exp(-step_s / self.geometry.lag_s) if self.geometry.lag_s > 0 else 1.0
        own, line = (curvature(each, self.geometry) for each in (steering, recorded))
        for number in range(steps):
            at = (number + 0.5) / steps
            way_m = step_s * (speed_mps[0] + at * (speed_mps[1] - speed_mps[0]))
            self._recorded += share * (line - self._recorded)
            self._own += share * (own - self._own)
            # the way of the car while the line is followed by way_m (Rajamani, section 2.5; Frenet's frame)
            own_m = way_m * (1.0 - self._recorded * self.left_m) / math.cos(self.turn_rad)
            turn = self.turn_rad + own_m * self._own - way_m * self._recorded
            self.left_m += own_m * math.sin((self.turn_rad + turn) / 2)
            self.turn_rad = min(_MAX_TURN_RAD, max(-_MAX_TURN_RAD, turn))
