"""What errors are where nothing can be measured, and at the edges of bins; their formulas: test_evaluation.py."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest

from model.metrics import constant_errors, errors, measure
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
