"""The errors of a run in each bin of the recorded steering, as bars of a picture: of the frames held out."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from common.steering_unit import assumed_deg

if TYPE_CHECKING:
    from model.metrics import Measures


def bin_bars(measures: Measures) -> dict[str, Any] | None:
    """The bars of a picture of errors in `unit` (its `sign` follows a number) up to `most`; `full` is steering 1.
    Places are in percent of it, from the left and the top. None where nothing was held out."""
    unit = measures.unit
    bins = [part for part in measures.bins if part.frames > 0 and math.isfinite(part.rmse_deg + part.bias_deg)]
    if not bins:
        return None
    most = 1.05 * max(max(part.rmse_deg, abs(part.bias_deg)) for part in bins)  # a line at the edge would be cut
    least = 1.05 * min(0.0, *(part.bias_deg for part in bins))
    room = (most - least) or 1.0
    frames = math.log(2 * max(part.frames for part in bins))  # one frame is a bar, too
    full = unit.of(assumed_deg(measures.max_deg))

    def top(error_deg: float) -> float:
        return 100 * (most - error_deg) / room

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
            "frames_top": 100 * (1 - math.log(2 * part.frames) / frames),
        }
        for part in bins
    ]
    shown = {"unit": unit.name, "sign": unit.sign, "full": full, "most": unit.of(most)}
    return {**shown, "zero_top": top(0.0), "bars": bars}
