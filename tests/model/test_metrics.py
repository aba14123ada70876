"""Errors are their formulas, and stand beside those of predictors that know nothing."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest

from model.metrics import constant_errors, errors, measure
from toy import STEERING


def test_errors_are_the_formulas() -> None:
    predicted, recorded = [0.0, 0.1, -0.2, 0.04], [0.0, 0.2, -0.4, 0.0]
    off_deg = [25 * (p - r) for p, r in zip(predicted, recorded, strict=True)]  # 0, -2.5, 5, 1
    found = errors(np.array(predicted), np.array(recorded))
    assert found.mae_deg == pytest.approx(8.5 / 4)
    assert found.rmse_deg == pytest.approx(math.sqrt(sum(x * x for x in off_deg) / 4))
    assert found.turning_mae_deg == pytest.approx((2.5 + 5) / 2)
    assert found.correlation == pytest.approx(statistics.correlation(predicted, recorded))


def test_the_mean_is_the_best_constant_and_has_no_correlation() -> None:
    recorded = np.array(STEERING)
    mean = constant_errors(float(recorded.mean()), recorded)
    assert mean.rmse_deg == pytest.approx(25 * statistics.pstdev(STEERING))
    assert mean.rmse_deg < constant_errors(0.0, recorded).rmse_deg
    assert mean.rmse_deg < constant_errors(float(recorded.mean()) + 0.01, recorded).rmse_deg
    assert math.isnan(mean.correlation)


def test_where_nothing_can_be_measured_is_nan() -> None:
    nothing = errors(np.zeros(0), np.zeros(0))
    assert all(map(math.isnan, (nothing.mae_deg, nothing.rmse_deg, nothing.turning_mae_deg, nothing.correlation)))
    assert math.isnan(errors(np.array([0.1]), np.array([0.0])).turning_mae_deg)


def test_errors_per_bin_are_those_of_the_frames_in_it() -> None:
    predicted, recorded = [0.0, 0.1, 0.5, 0.7, -0.9], [0.0, 0.0, 0.61, 0.79, -1.0]
    bins = {part.bin: part for part in measure(np.array(predicted), np.array(recorded), bins=5).bins}
    assert sorted(bins) == [0, 2, 4]  # of -1 .. -0.6, -0.6 .. -0.2, ...: two are empty
    assert [bins[number].frames for number in (0, 2, 4)] == [1, 2, 2]
    assert [bins[4].low, bins[4].high] == pytest.approx([0.6, 1.0])
    assert bins[4].mae_deg == pytest.approx(25 * (0.11 + 0.09) / 2)
    assert bins[4].rmse_deg == pytest.approx(25 * math.sqrt((0.11**2 + 0.09**2) / 2))
    assert bins[4].bias_deg == pytest.approx(-25 * (0.11 + 0.09) / 2)
    assert bins[2].bias_deg == pytest.approx(25 * 0.05)


def test_an_edge_between_bins_is_the_same_one_in_float32() -> None:
    for recorded in (0.2, 0.04, -0.6):
        single = measure(np.zeros(1), np.array([recorded], np.float32))
        double = measure(np.zeros(1), np.array([recorded], np.float64))
        assert single.bins[0].bin == double.bins[0].bin


def test_the_balanced_error_counts_every_bin_alike() -> None:
    """98 frames straight on and two bends: always going straight is nearly right, but not in this measure."""
    recorded = np.array([0.0] * 98 + [-0.8, 0.8])
    straight = measure(np.zeros(100), recorded)
    assert straight.network.rmse_deg == pytest.approx(25 * 0.8 * math.sqrt(0.02))
    assert straight.balanced_rmse_deg == pytest.approx(25 * 0.8 * math.sqrt(2 / 3))
    assert math.isnan(measure(np.zeros(0), np.zeros(0)).balanced_rmse_deg)
