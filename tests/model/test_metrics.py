"""What errors are where nothing can be measured, and at the edges of bins; their formulas: test_evaluation.py."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest

from model.epoch_printer import EpochPrinter
from model.metrics import constant_errors, errors, measure, target_errors
from model.runs.training_progress import Epoch
from tests.helpers.toy import STEERING


def test_no_constant_does_better_than_the_mean() -> None:
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
    assert math.isnan(measure(np.zeros(0), np.zeros(0)).balanced_rmse_deg)


def test_an_unknown_correlation_is_printed_as_a_dash(capsys: pytest.CaptureFixture[str]) -> None:
    """Of steering or of a pedal that never changes."""
    still = np.full(60, 0.25)
    throttle = target_errors("throttle", np.zeros(60), still)
    EpochPrinter("last").epoch(
        Epoch(1, 0.1, 0.1, measure(still + 0.1, still), True, 1.0, 100.0, targets=(throttle,))
    )
    printed = capsys.readouterr().out
    assert "nan" not in printed
    assert printed.count("correlation -") == 2


def test_an_edge_between_bins_is_the_same_one_in_float32() -> None:
    for recorded in (0.2, 0.04, -0.6):
        single = measure(np.zeros(1), np.array([recorded], np.float32))
        double = measure(np.zeros(1), np.array([recorded], np.float64))
        assert single.bins[0].bin == double.bins[0].bin


def test_a_turn_is_the_same_in_float32() -> None:
    """bc-train measures float32, bc-eval float64."""
    for recorded in (0.05, -0.05):  # not above 0.05, but np.float32(0.05) is
        assert math.isnan(errors(np.zeros(1), np.array([recorded], np.float32)).turning_mae_deg)
        assert math.isnan(errors(np.zeros(1), np.array([recorded], np.float64)).turning_mae_deg)
