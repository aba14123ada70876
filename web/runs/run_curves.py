"""The curves of a training, and the colours of runs. x is in epochs, so that runs of any size can be compared."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from model.runs.history import History
    from model.runs.training_progress import Epoch

Line = tuple[list[float], list[float | None]]  # x and y; None for a missing number

_MAX_STEPS: Final = 2000
COLOURS: Final = 8
"""The number of colours in the style sheet (`--series-0` and so on)."""


def run_curves(history: History) -> dict[str, Line]:
    """The curves by name. Errors are shares of the error of always predicting the mean, because runs hold out
    different frames."""
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


def run_colours(names: Iterable[str]) -> dict[str, int]:
    """A number from 0 to `COLOURS` - 1 for each run, which hardly depends on the other names. Up to `COLOURS` runs
    get different numbers: of two runs with the same one, the later by name gets another."""
    colours = dict[str, int]()
    for name in sorted(set(names)):
        first = zlib.crc32(name.encode()) % COLOURS
        numbers = [(first + step) % COLOURS for step in range(COLOURS)]
        colours[name] = next((number for number in numbers if number not in colours.values()), first)
    return colours
