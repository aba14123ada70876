"""The errors of a run in each bin of the recorded steering, as bars of a picture: of the frames held out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from common.steering_unit import assumed_deg

if TYPE_CHECKING:
    from model.metrics import Measures


@dataclass(frozen=True)
class BinBar:
    """One bin: the steering in it, its errors in the unit of the picture, and its place in percent of the
    picture's width and height, from the left and the top."""

    low: float  # in the unit of the picture, as all that follows
    high: float
    rmse: float
    bias: float  # above 0: too far to the right
    frames: int
    left: float
    width: float
    rmse_top: float
    bias_top: float
    frames_top: float


@dataclass(frozen=True)
class BinBars:
    unit: str
    sign: str  # right after a number
    full: float  # steering 1
    most: float  # the largest error that the picture has room for
    zero_top: float  # of no error, in percent from the top
    bars: Sequence[BinBar]


def bin_bars(measures: Measures) -> BinBars | None:
    """None where nothing was held out."""
    unit = measures.unit
    bins = [part for part in measures.bins if part.frames > 0 and math.isfinite(part.rmse_deg + part.bias_deg)]
    if not bins:
        return None
    most = max(max(part.rmse_deg, abs(part.bias_deg)) for part in bins)
    least = min(0.0, *(part.bias_deg for part in bins))
    most, least = 1.05 * most, 1.05 * least  # a line at the edge would be cut
    room = (most - least) or 1.0
    frames = math.log(2 * max(part.frames for part in bins))  # one frame is a bar, too

    def top(error_deg: float) -> float:
        return 100 * (most - error_deg) / room

    full = unit.of(assumed_deg(measures.max_deg))
    return BinBars(
        unit.name,
        unit.sign,
        full,
        unit.of(most),
        top(0.0),
        [
            BinBar(
                part.low * full,
                part.high * full,
                unit.of(part.rmse_deg),
                unit.of(part.bias_deg),
                part.frames,
                50 * (part.low + 1),
                50 * (part.high - part.low),
                top(part.rmse_deg),
                top(part.bias_deg),
                100 * (1 - math.log(2 * part.frames) / frames),
            )
            for part in bins
        ],
    )
