"""The keyboard's driver keeps to the road with what keys can do, as late and as seldom as people press them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.driving.course import Course
from simulator.driving.keyboard import KeyPress
from simulator.driving.recovery_driving import DriveStep, drive_for_recording
from simulator.driving.simulated_driver import make_driver
from simulator.driving.vehicle import STEP_S
from simulator.roads.track import load_track

TRACKS = {name: load_track(name) for name in ("lake", "mountain")}
# a step of the ramp by which Unity's axis moves at 50 Hz; sensitivity and gravity are 3 full locks a second
RAMP = 3.0 * STEP_S + 1e-9


def drive(
    track: str, laps: float = 0.5, mph: float = 10, rate: float = 10, share: float = 0.0, seed: int = 0
) -> list[DriveStep]:
    driver = make_driver("keyboard", TRACKS[track].line, mph, 0.03, seed)
    return list(drive_for_recording(Course(TRACKS[track]), driver, laps, rate, share, seed))


def steering(steps: list[DriveStep]) -> NDArray[np.float64]:
    return np.array([step.steering for step in steps])


@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("share", [0.0, 0.35])
def test_it_stays_on_the_road_for_half_a_lap(track: str, share: float) -> None:
    steps = drive(track, share=share)
    assert steps[-1].progress_m > 0.5 * TRACKS[track].line.length_m - 2.0
    assert max(abs(step.offset) for step in steps) < 1.0


def test_between_two_steps_the_steering_moves_as_keys_move_it() -> None:
    found = steering(drive("mountain", laps=0.1, rate=50))
    moved = np.abs(np.diff(found))
    assert moved.max() <= RAMP
    assert np.abs(found).max() == 1.0  # full lock, in a hairpin
    # from one side to the other only through the middle
    assert not ((found[1:] * found[:-1]) < 0).any()
    # it ramps, holds full lock, or lies at the middle; elsewhere it rests at most where a key is let go
    resting = (moved == 0.0) & (np.abs(found[1:]) > 0.0) & (np.abs(found[1:]) < 1.0)
    assert not resting.any()


def test_the_same_seed_is_the_same_drive() -> None:
    assert drive("lake", laps=0.05, seed=4) == drive("lake", laps=0.05, seed=4)
    assert drive("lake", laps=0.05, seed=4) != drive("lake", laps=0.05, seed=5)


def test_after_a_gap_no_key_is_held_any_more() -> None:
    steps = drive("mountain", laps=0.2, share=0.5, rate=50)
    gaps = [(before, after) for before, after in itertools.pairwise(steps) if after.after_gap]
    assert any(before.steering != 0.0 for before, _ in gaps)
    assert all(after.steering == 0.0 for _, after in gaps)


def test_a_press_ramps_up_holds_and_ramps_down() -> None:
    press = KeyPress(-1.0, down_s=1.0, up_s=1.5)
    at = [press.steering(t) for t in (0.5, 1.0, 1.1, 1.4, 1.6, 1.9)]
    assert at == pytest.approx([0.0, 0.0, -0.3, -1.0, -0.7, 0.0])
    tap = KeyPress(1.0, down_s=0.0, up_s=0.1)
    assert [tap.steering(t) for t in (0.1, 0.15, 0.25)] == pytest.approx([0.3, 0.15, 0.0])
    assert math.isclose(sum(tap.steering(k / 1000) for k in range(300)) / 1000, 3 * 0.1**2, rel_tol=1e-3)
