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

from dataset.picture_spec import ORIGINAL
from dataset.preprocessing import Image
from dataset.viewpoint import Viewpoint
from recorder.log.session_car import OUTLINE_PX, UDACITY

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
