"""bc-eval says how much later than the network a person steers: a late person is not a bad network."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray

from model.evaluation.reaction_time import reaction_time

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
