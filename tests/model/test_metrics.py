"""What errors are where nothing can be measured, and at the edges of bins; their formulas: test_evaluation.py."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray

from model.evaluation.differences import intervals
from model.metrics import constant_errors, errors, measure, reaction_time
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


START_NS = 1_700_000_000_000_000_000
PRESSES = np.random.default_rng(0).choice([-0.6, 0.0, 0.0, 0.6], 60).repeat(4)  # each of 0.4 s


def frames(
    predicted: NDArray[np.float64], recorded: NDArray[np.float64], session: str = "a", step_s: float = 0.1
) -> pa.Table:
    return pa.table(
        {
            "session": [session] * len(recorded),
            "log_time_ns": START_NS + round(step_s * 1e9) * np.arange(len(recorded)),
            "recorded": recorded,
            "predicted": predicted,
        }
    )


@pytest.mark.parametrize("late", [0, 2, 5])
def test_a_person_who_steers_late_is_compared_late(late: int) -> None:
    later = frames(PRESSES[late:], PRESSES[: len(PRESSES) - late])
    found = reaction_time(later)
    assert found is not None
    assert found.delay_s == pytest.approx(0.1 * late)
    assert found.correlation == pytest.approx(1.0)


@pytest.mark.parametrize("step_s", [0.1, 0.25])
def test_noise_in_the_recorded_steering_is_no_delay(step_s: float) -> None:
    """The mean of two frames would have less noise: half a step later, its correlation would be larger."""
    bends = 0.5 * np.sin(np.arange(600) / 5)
    noisy = frames(bends, bends + 0.2 * np.random.default_rng(0).standard_normal(600), step_s=step_s)
    found = reaction_time(noisy)
    assert found is not None
    assert found.delay_s == 0.0


def test_the_delay_is_that_of_the_frames_compared() -> None:
    """At 4 frames a second, only 0.25 s and 0.5 s later is there a frame."""
    found = reaction_time(frames(PRESSES[1:], PRESSES[:-1], step_s=0.25))
    assert found is not None
    assert found.delay_s == pytest.approx(0.25)


def test_each_session_is_compared_with_itself() -> None:
    late = [frames(sign * PRESSES[2:], sign * PRESSES[:-2], name) for name, sign in (("a", 1.0), ("b", -1.0))]
    mixed = pa.concat_tables(late).take(np.random.default_rng(1).permutation(2 * (len(PRESSES) - 2)))
    found = reaction_time(mixed)
    assert found is not None
    assert (found.delay_s, found.correlation) == pytest.approx((0.2, 1.0))


def test_no_steering_is_taken_from_the_next_drive() -> None:
    """Drives of 0.4 s, each steered constantly: 0.3 s later only their first frames have steering."""
    table = frames(PRESSES, PRESSES)
    pause_ns = 5_000_000_000 * (np.arange(len(PRESSES)) // 4)
    apart = table.set_column(1, "log_time_ns", pa.array(table["log_time_ns"].to_numpy() + pause_ns))
    found = reaction_time(apart)
    assert found is not None
    assert found.delay_s == 0.0
    assert found.correlation == pytest.approx(1.0)


def test_frames_without_later_steering_give_no_delay() -> None:
    """Drives of 1 s, each steered constantly, with a wrong answer at the end: later, only right ones are left."""
    drive = np.arange(60) // 10
    bends = np.array([0.3, -0.3, 0.1, -0.1, 0.2, -0.2])[drive]
    wrong = np.where(np.arange(60) % 10 == 9, -bends, bends)
    table = frames(wrong, bends)
    apart = table.set_column(1, "log_time_ns", pa.array(table["log_time_ns"].to_numpy() + 5_000_000_000 * drive))
    found = reaction_time(apart)
    assert found is not None
    assert (found.delay_s, found.correlation) == (0.0, found.at_once)
