"""The labels of views from beside the line: they lead back to it."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.car import MPS_PER_MPH
from dataset.drawn_views import Numbers, Values, place_of
from recorder.log.session_car import Car

SLOW_MPH: Final = 5.0
"""Slower than this, people set off, or manoeuvre at walls with the wheels turned to their stop."""
BACK_S: Final = 2.0
"""The time in which labels lead back to the line (Bojarski et al. 2016, section 5.2)."""


def has_way_back(speed_mph: Values) -> NDArray[np.bool_]:
    """True where a view has a label: not at an unknown speed, nor at that of a car which only manoeuvres."""
    return np.asarray(speed_mph >= SLOW_MPH)


def label_back(steering: Values, speed_mph: Values, view: Numbers, car: Car) -> Values:
    """The steering (N,), -1..1, that leads a car from a view back to the line, of the line's own `steering` (N,).

    The car is to be back on the line, and in its direction, in `BACK_S`. Of all ways to get there, the one that
    steers least begins with a curvature of (6 offset / way + 4 turn) / way towards the line (the control of least
    effort that brings a double integrator to a final state: Bryson and Ho, Applied Optimal Control, section 5.3).
    """
    left_m, turn_rad = place_of(view)
    way_m = speed_mph * MPS_PER_MPH * BACK_S
    to_the_right = (6.0 * left_m / way_m + 4.0 * turn_rad) / way_m
    max_rad = car.max_wheel_rad
    bend = np.tan(steering * max_rad) / car.wheelbase_m + to_the_right
    return np.clip(np.arctan(bend * car.wheelbase_m) / max_rad, -1.0, 1.0) + 0.0
