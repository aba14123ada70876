"""Curves of the predictions of networks: their steering, and its error."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from model.evaluation.log_predictions import LogPredictions
from recorder.topics import STEERING
from viz.playback.blueprint import ERRORS, Curve, entity_part

COLORS: Final = ((240, 90, 190), (240, 220, 90), (90, 220, 220), (170, 120, 240), (230, 90, 90), (150, 200, 80))


def prediction_curves(
    predictions: LogPredictions, first: int = 0
) -> Iterator[tuple[Curve, NDArray[np.int64], NDArray[np.float64]]]:
    """The lines of each run: the curve, log times (N,) in ns, values (N,). `first` is the first run's number,
    which gives its colour. There is no error where nothing was recorded."""
    is_recorded = np.isfinite(predictions.recorded)
    for number, (run, steering) in enumerate(predictions.predicted.items(), first):
        color, part = COLORS[number % len(COLORS)], entity_part(run)
        yield Curve(f"{STEERING.path}/predicted_by/{part}", run, color), predictions.log_time_ns, steering
        if is_recorded.any():
            yield (
                Curve(f"{ERRORS}/{part}", run, color),
                predictions.log_time_ns[is_recorded],
                predictions.unit.per_deg * predictions.error_deg(run)[is_recorded],
            )
