"""How far predictions are off, beside predictors that know nothing.

Half to four fifths of recorded labels are near zero, so that a small mean error alone says nothing: every
measure stands beside those of always predicting zero, and the mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dataset import MAX_STEERING_DEG

TURNING = 0.05  # |steering| above this is turning

Floats = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True)
class Errors:
    """Errors in degrees of wheel angle; NaN where there is nothing to measure."""

    mae_deg: float
    rmse_deg: float
    turning_mae_deg: float
    correlation: float  # -1..1; NaN where either side is constant


def errors(predicted: Floats, recorded: Floats) -> Errors:
    """Compare two steering arrays (N,), -1..1."""
    nan = float("nan")
    if not len(recorded):
        return Errors(nan, nan, nan, nan)
    off = MAX_STEERING_DEG * (predicted.astype(np.float64) - recorded.astype(np.float64))
    turning = np.abs(recorded) > TURNING
    varies = predicted.min() < predicted.max() and recorded.min() < recorded.max()
    return Errors(
        mae_deg=float(np.abs(off).mean()),
        rmse_deg=float(np.sqrt(np.square(off).mean())),
        turning_mae_deg=float(np.abs(off[turning]).mean()) if turning.any() else nan,
        correlation=float(np.corrcoef(predicted, recorded)[0, 1]) if varies else nan,
    )


def constant_errors(value: float, recorded: Floats) -> Errors:
    """The errors of always predicting `value`."""
    return errors(np.full(len(recorded), value), recorded)
