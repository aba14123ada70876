"""Intervals by blocks of time hold as often as they promise, where those of single frames do not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from model.evaluation.block_bootstrap import intervals

Floats = NDArray[np.float64]


def series(count: int, frames: int) -> Floats:
    """So many of them (count, frames), around 0, each value much like the one before, as errors of steering are at
    10 Hz: those 20 frames apart have a correlation of 0.12."""
    generator = np.random.default_rng(1)
    values = generator.normal(size=(count, frames))
    for frame in range(1, frames):
        values[:, frame] = 0.9 * values[:, frame - 1] + np.sqrt(1 - 0.9**2) * values[:, frame]
    return values


def mean(sums: Floats) -> Floats:
    return sums[..., :1] / sums[..., 1:]


def covers(values: Floats, block: int) -> bool:
    """Whether the interval of the mean holds the 0 that the values are drawn around."""
    parts = values.reshape(-1, block)
    sums = np.column_stack([parts.sum(axis=1), np.full(len(parts), block)])
    (low,), (high,) = intervals(sums, mean, 0.95, draws=1000)
    return bool(low <= 0 <= high)


@pytest.mark.parametrize(("blocks", "least"), [(6, 0.85), (20, 0.92)])
def test_the_interval_of_blocks_holds_as_often_as_promised(blocks: int, least: float) -> None:
    """Or nearly: neighbouring blocks of 5 s have a little to do with each other, too."""
    assert np.mean([covers(values, 50) for values in series(200, 50 * blocks)]) > least


def test_it_is_as_wide_as_the_formula_for_a_mean() -> None:
    generator = np.random.default_rng(2)
    values = generator.normal(size=400)
    (low,), (high,) = intervals(np.column_stack([values, np.ones(400)]), mean, 0.95)
    standard_error = values.std(ddof=1) / np.sqrt(400)
    assert (low + high) / 2 == pytest.approx(values.mean(), abs=0.1 * standard_error)
    assert (high - low) / 2 == pytest.approx(1.966 * standard_error, rel=0.05)  # Student's t, 399 degrees


def test_the_same_sums_give_the_same_interval_and_missing_ones_none() -> None:
    sums = np.column_stack([np.arange(8.0), np.ones(8)])
    assert np.array_equal(intervals(sums, mean, 0.95), intervals(sums, mean, 0.95))
    assert np.isnan(intervals(sums, lambda drawn: np.full_like(mean(drawn), np.nan), 0.95)).all()
