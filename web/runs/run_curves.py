"""The curves of a training. x is in epochs, so that runs of any size can be compared."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from model.runs.history import History
    from model.runs.training_progress import Epoch

Line = tuple[list[float], list[float | None]]  # x and y; None for a missing number

_MAX_STEPS = 2000


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
        "RMSE": line(map(_rmse, history.epochs)),
        "balanced RMSE": line(map(_balanced, history.epochs)),
        "correlation": line(epoch.measures.network.correlation for epoch in history.epochs),
    }
    errors = [
        {error.target: _share(error.rmse, error.mean_rmse) for error in epoch.targets} for epoch in history.epochs
    ]
    for target in dict.fromkeys(target for shares in errors for target in shares):
        lines[f"RMSE of {target}"] = line(shares.get(target, math.nan) for shares in errors)
    return lines


def _rmse(epoch: Epoch) -> float:
    return _share(epoch.measures.network.rmse_deg, epoch.measures.mean.rmse_deg)


def _balanced(epoch: Epoch) -> float:
    if not epoch.measures.frames:
        return math.nan
    return _share(epoch.measures.balanced_rmse_deg, epoch.measures.mean_balanced_rmse_deg)


def _share(value: float, whole: float) -> float:
    return value / whole if whole else math.nan


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
