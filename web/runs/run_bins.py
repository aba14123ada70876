"""The errors of a run on held-out frames in each bin of the recorded steering, as bars of a picture."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from common.steering_unit import assumed_deg

if TYPE_CHECKING:
    from model.metrics import Measures


def bin_bars(measures: Measures) -> dict[str, Any] | None:
    """The bars of a picture of errors in `unit` (its `sign` follows a number) up to `top`. `full` is steering 1.
    Places are in percent of the picture, from the left and the top. None if no frames were held out."""
    unit = measures.unit
    bins = [part for part in measures.bins if part.frames > 0 and math.isfinite(part.rmse_deg + part.bias_deg)]
    if not bins:
        return None
    top_deg = 1.05 * max(max(part.rmse_deg, abs(part.bias_deg)) for part in bins)  # room for the line at the edge
    bottom_deg = 1.05 * min(0.0, *(part.bias_deg for part in bins))
    height_deg = (top_deg - bottom_deg) or 1.0
    max_log = math.log(2 * max(part.frames for part in bins))  # twice: a single frame has a bar, too
    full = unit.of(assumed_deg(measures.max_deg))

    def top(error_deg: float) -> float:
        return 100 * (top_deg - error_deg) / height_deg

    bars = [
        {
            "low": part.low * full,
            "high": part.high * full,
            "rmse": unit.of(part.rmse_deg),
            "bias": unit.of(part.bias_deg),  # above 0: too far to the right
            "frames": part.frames,
            "left": 50 * (part.low + 1),
            "width": 50 * (part.high - part.low),
            "rmse_top": top(part.rmse_deg),
            "bias_top": top(part.bias_deg),
            "frames_top": 100 * (1 - math.log(2 * part.frames) / max_log),
        }
        for part in bins
    ]
    scale = {"unit": unit.name, "sign": unit.sign, "full": full, "top": unit.of(top_deg)}
    return {**scale, "zero_top": top(0.0), "bars": bars}
