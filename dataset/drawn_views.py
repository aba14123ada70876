"""Views from beside the line for training: their places, and their pictures.

A network that has only seen the middle of the road does not know what to do beside it. Side cameras show that from
two places; of the centre camera's pictures, any other place can be warped (`dataset/viewpoint.py`).
"""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.car import MPS_PER_MPH
from dataset.picture_spec import ORIGINAL
from dataset.preprocessing import Image
from dataset.viewpoint import Viewpoint
from recorder.log.session_car import OUTLINE_PX, UDACITY, Car

VIEWPOINT: Final = "viewpoint"
"""The alteration of a sample that shows such a view."""
MAX_LEFT_M: Final = 0.8  # to either side, about as far as the side cameras
MAX_TURN_RAD: Final = math.radians(6.0)

LAST_VIEW: Final = 0xFFFF_FFFF
"""The largest number of a view. In a sample's seed the bits above are those of its other alterations, 0 where it
is shown for the first time."""

_MOST: Final = 0xFFFF  # a view's number: 16 bits for where it is, 16 for how it is turned

Values = NDArray[np.float64]
Numbers = NDArray[np.int64]


def draw_views(count: int, random: np.random.Generator) -> Numbers:
    """Numbers (N,) of views. Each number stands for a place beside the line and a turn."""
    return random.integers(0, LAST_VIEW, count, endpoint=True)


def mirrored_view(view: Numbers) -> Numbers:
    """The number of the view from the other side, turned the other way."""
    return view ^ ((_MOST << 16) | _MOST)


def place_of(view: Numbers | int) -> tuple[Values, Values]:
    """Metres to the left of the line, and the turn to the left in rad, of views by their numbers, or by the seeds
    that hold them in their lowest 32 bits."""
    shares = [(np.asarray(view) >> bits & _MOST) / (_MOST / 2) - 1.0 for bits in (0, 16)]
    return shares[0] * MAX_LEFT_M, shares[1] * MAX_TURN_RAD


def crop_from(crop: Image, seed: int, cameras: Viewpoint | None = None) -> Image:
    """The crop as seen from the view whose number is in a seed's lowest 32 bits. `cameras` took the picture; by
    default Udacity's, of which the original network's crop (128, 128, 3) was made."""
    left_m, turn_rad = place_of(seed)
    return (cameras or _udacity()).picture(crop, float(left_m), float(turn_rad))


@cache
def _udacity() -> Viewpoint:
    return Viewpoint(UDACITY, *OUTLINE_PX, of_crops=ORIGINAL)


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
