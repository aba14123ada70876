"""The charts of runs: the curves of a training, its errors by steering, and the colour of each run."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

from common.steering_unit import assumed_deg

if TYPE_CHECKING:
    from model.metrics import Measures
    from model.runs.history import History
    from model.runs.training_progress import Epoch

Line = tuple[list[float], list[float | None]]  # x and y; None for a missing number

_MAX_STEPS: Final = 2000
COLOURS: Final = 8
"""The number of colours in the style sheet (`--series-0` and so on)."""


def run_curves(history: History) -> dict[str, Line]:
    """The curves by name. x is in epochs, so that runs of any size can be compared. Errors are shares of the error
    of always predicting the mean, because runs hold out different frames."""
    steps = history.steps[:: len(history.steps) // _MAX_STEPS + 1]
    ends = [float(epoch.epoch) for epoch in history.epochs]

    def line(values: Iterable[float]) -> Line:
        return ends, [_number(value) for value in values]

    lines = {
        "training loss": (
            [step.epoch - 1 + step.batch / step.batches for step in steps],
            [_number(step.training_loss) for step in steps],
        )
        if steps
        else line(epoch.training_loss for epoch in history.epochs),
        "validation loss": line(epoch.validation_loss for epoch in history.epochs),
        "RMSE": line(
            _share(epoch.measures.network.rmse_deg, epoch.measures.mean.rmse_deg) for epoch in history.epochs
        ),
        "balanced RMSE": line(map(_balanced, history.epochs)),
        "correlation": line(epoch.measures.network.correlation for epoch in history.epochs),
    }
    errors = [
        {error.target: _share(error.rmse, error.mean_rmse) for error in epoch.targets} for epoch in history.epochs
    ]
    for target in dict.fromkeys(target for shares in errors for target in shares):
        lines[f"RMSE of {target}"] = line(shares.get(target, math.nan) for shares in errors)
    return lines


def _balanced(epoch: Epoch) -> float:
    if not epoch.measures.frames:
        return math.nan
    return _share(epoch.measures.balanced_rmse_deg, epoch.measures.mean_balanced_rmse_deg)


def _share(value: float, whole: float) -> float:
    return value / whole if whole else math.nan


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def bin_bars(measures: Measures) -> dict[str, Any] | None:
    """The bars of a picture of the errors on held-out frames, by the recorded steering. Errors are in `unit` (its
    `sign` follows a number) up to `top`. `full` is steering 1. Places are in percent of the picture, from the left
    and the top. None if no frames were held out."""
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


def run_colours(names: Iterable[str]) -> dict[str, int]:
    """A number from 0 to `COLOURS` - 1 for each run, which hardly depends on the other names. Up to `COLOURS` runs
    get different numbers: of two runs with the same one, the later by name gets another."""
    colours = dict[str, int]()
    for name in sorted(set(names)):
        first = zlib.crc32(name.encode()) % COLOURS
        numbers = [(first + step) % COLOURS for step in range(COLOURS)]
        colours[name] = next((number for number in numbers if number not in colours.values()), first)
    return colours
