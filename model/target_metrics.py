"""Errors of the targets besides steering, beside those of always predicting the mean."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset.prediction_targets import TARGETS, TargetName

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TargetErrors:
    """The errors of a target on the frames with a known label, in its unit; NaN where there is nothing to
    measure."""

    target: TargetName
    frames: int
    mae: float
    rmse: float
    bias: float  # mean of predicted - recorded
    correlation: float  # -1..1; NaN where either side is constant
    mean_rmse: float  # of always predicting those frames' own mean: no constant does better

    def as_dict(self) -> dict[str, Any]:
        """For JSON, with the unit."""
        return {**asdict(self), "unit": TARGETS[self.target].unit}

    def __str__(self) -> str:
        """ "speed: RMSE 1.42 mph (always the mean: 4.10), correlation 0.93"."""
        unit = f" {TARGETS[self.target].unit}".rstrip()
        return (
            f"{self.target}: RMSE {self.rmse:.2f}{unit} (always the mean: {self.mean_rmse:.2f}),"
            f" correlation {self.correlation:.2f}"
        )


def target_errors(target: TargetName, predicted: Floats, recorded: Floats) -> TargetErrors:
    """Compare two arrays (N,) in the target's unit; NaN in `recorded`: not known."""
    is_known = np.isfinite(recorded)
    predicted, recorded = predicted[is_known], recorded[is_known]
    nan = math.nan
    if not len(recorded):
        return TargetErrors(target, 0, nan, nan, nan, nan, nan)
    off = predicted - recorded
    varies = np.ptp(predicted) > 0 and np.ptp(recorded) > 0
    return TargetErrors(
        target,
        len(recorded),
        float(np.abs(off).mean()),
        float(np.sqrt(np.square(off).mean())),
        float(off.mean()),
        float(np.corrcoef(predicted, recorded)[0, 1]) if varies else nan,
        float(np.std(recorded)),
    )


def other_targets(targets: Sequence[TargetName], predicted: Floats, recorded: Floats) -> tuple[TargetErrors, ...]:
    """The errors of all targets but steering; labels and answers as `dataset.prediction_targets` has them."""
    if len(targets) == 1:
        return ()
    return tuple(
        target_errors(name, predicted[:, at] * TARGETS[name].per_unit, recorded[:, at] * TARGETS[name].per_unit)
        for at, name in enumerate(targets)
        if at
    )
