"""Drivers like people keep to the road with what keys and a mouse can do, as late and as seldom as people do."""

from __future__ import annotations

import functools
import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.driving.course import Course
from simulator.driving.drive_limits import DriverName
from simulator.driving.person import FULL_LOCK_PX, REACTION_S, make_driver
from simulator.driving.recovery_driving import PUSH_S, DriveStep, drive_for_recording
from simulator.driving.vehicle import STEP_S
from simulator.roads.track import load_track

TRACKS = {name: load_track(name) for name in ("lake", "mountain")}
PEOPLE: list[DriverName] = ["keyboard", "mouse"]


@functools.cache
def drive(
    name: DriverName,
    track: str,
    laps: float = 0.5,
    mph: float = 10,
    rate: float = 10,
    share: float = 0.0,
    seed: int = 0,
    noise: float = 0.03,
) -> list[DriveStep]:
    driver = make_driver(name, TRACKS[track].line, mph, noise, seed)
    return list(drive_for_recording(Course(TRACKS[track]), driver, laps, rate, share, seed))


def left_road(steps: list[DriveStep]) -> int:
    return sum(step.after_gap and not step.recovering for step in steps)


def degrees(steps: list[DriveStep]) -> NDArray[np.float64]:
    return np.array([25.0 * step.steering for step in steps])


def stretches(steering: NDArray[np.float64]) -> tuple[list[int], list[int]]:
    """The numbers of rows of each stretch to one side, and of each straight ahead."""
    runs_of_rows = [(side, len(list(rows))) for side, rows in itertools.groupby(np.sign(steering).tolist())]
    return [rows for side, rows in runs_of_rows if side], [rows for side, rows in runs_of_rows if not side]


@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", PEOPLE)
def test_a_lap_is_driven_on_the_road(name: DriverName, track: str) -> None:
    steps = drive(name, track, laps=1.0)
    assert steps[-1].progress_m > TRACKS[track].line.length_m - 2.0
    assert left_road(steps) == 0
    assert max(abs(step.offset) for step in steps) < 0.9


@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", PEOPLE)
def test_pushed_off_its_line_it_comes_back(name: DriverName, track: str) -> None:
    steps = drive(name, track, laps=0.4, share=0.35)
    assert left_road(steps) == 0
    assert np.mean([step.recovering for step in steps]) == pytest.approx(0.35, abs=0.12)
    pushed = [abs(step.offset) for step in steps if step.after_gap]
    back = [abs(before.offset) for before, step in itertools.pairwise(steps) if step.after_gap]
    assert len(pushed) > 5
    assert np.median(back) < 0.25 < np.median(pushed)


# What recordings of people have, at 9 to 14 rows a second (docs/studies/drivers.md); the lengths of presses are in
# whole rows, here of 0.1 s.
HABITS = {
    "keyboard": {"zeros": (0.57, 0.80), "a minute": (30, 78), "press": (0.2, 0.4), "straight": (0.3, 0.7)},
    "mouse": {"zeros": (0.44, 0.65), "a minute": (23, 36), "press": (0.8, 1.0), "straight": (0.5, 0.9)},
}


@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", PEOPLE)
def test_it_steers_as_often_and_as_long_as_people_do(name: DriverName, track: str) -> None:
    steering = degrees(drive(name, track, laps=1.0))
    presses, straights = stretches(steering)
    habits = {
        "zeros": np.mean(steering == 0.0),
        "a minute": len(presses) / (len(steering) * 0.1 / 60),
        "press": np.median(presses) * 0.1,
        "straight": np.median(straights) * 0.1,
    }
    for name_of_habit, (least, most) in HABITS[name].items():
        assert least <= round(float(habits[name_of_habit]), 6) <= most, (name_of_habit, habits[name_of_habit])
    assert 4.0 < steering.std() < 10.4
    assert len(np.unique(steering)) > 150


def test_keyboard_rows_are_predicted_no_better_than_a_persons() -> None:
    steering = degrees(drive("keyboard", "lake", laps=1.0))
    neighbours = (steering[:-4] + steering[1:-3] + steering[3:-1] + steering[4:]) / 4  # 0.2 s around
    assert 0.75 < np.corrcoef(steering[2:-2], neighbours)[0, 1] < 0.92
    calm = degrees(drive("expert", "lake", laps=0.2))
    assert np.corrcoef(calm[2:-2], (calm[:-4] + calm[1:-3] + calm[3:-1] + calm[4:]) / 4)[0, 1] > 0.97


def test_keys_ramp_at_three_full_locks_a_second_through_the_middle() -> None:
    steering = degrees(drive("keyboard", "mountain", laps=0.12, rate=50)) / 25.0
    moved = np.abs(np.diff(steering))
    assert moved.max() <= 3.0 * STEP_S + 1e-9
    assert np.abs(steering).max() == 1.0  # full lock, in a hairpin
    assert not (steering[1:] * steering[:-1] < 0).any()
    assert not np.signbit(steering[steering == 0.0]).any()
    resting = moved == 0.0
    assert set(np.abs(steering[1:][resting])) == {0.0, 1.0}  # nothing in between is held


def test_a_mouse_is_dragged_by_whole_pixels_one_way_and_let_go_at_once() -> None:
    steering = degrees(drive("mouse", "mountain", laps=0.12, rate=50)) / 25.0
    pixels = steering * FULL_LOCK_PX
    assert pixels == pytest.approx(np.round(pixels), abs=1e-9)
    same_side = steering[1:] * steering[:-1] > 0
    assert (np.diff(np.abs(steering))[same_side] >= 0).all()
    assert not (steering[1:] * steering[:-1] < 0).any()


@pytest.mark.parametrize("name", PEOPLE)
def test_after_a_push_nobody_answers_sooner_than_people_can(name: DriverName) -> None:
    steps = drive(name, "lake", laps=0.3, rate=50, share=0.5)
    pushes = [at for at, step in enumerate(steps) if step.after_gap]
    assert any(steps[at - 1].steering != 0.0 for at in pushes)  # what was held then is let go
    late_s = []
    for at, after in itertools.pairwise([*pushes, len(steps)]):
        assert steps[at].time_s - steps[at - 1].time_s > PUSH_S
        answer = next((row for row in range(at, after) if steps[row].steering != 0.0), None)
        if answer is not None:
            late_s.append(steps[answer].time_s - steps[at].time_s)
    assert len(late_s) > 5
    assert min(late_s) >= 0.75 * REACTION_S
    assert np.median(late_s) < 2.5 * REACTION_S


@pytest.mark.parametrize("name", PEOPLE)
def test_the_same_seed_is_the_same_drive(name: DriverName) -> None:
    once = drive(name, "lake", laps=0.03, seed=4)
    drive.cache_clear()
    assert drive(name, "lake", laps=0.03, seed=4) == once
    assert drive(name, "lake", laps=0.03, seed=5) != once


def test_who_leaves_the_road_goes_on_from_its_middle_after_a_gap() -> None:
    steps = drive("keyboard", "mountain", laps=0.1, mph=30, noise=0.5)
    assert left_road(steps) > 0
    assert max(abs(step.offset) for step in steps) <= 1.0
    for before, after in itertools.pairwise(steps):
        if after.after_gap:
            assert after.offset == pytest.approx(0.0, abs=1e-6)
            assert after.time_s - before.time_s == pytest.approx(0.1 + PUSH_S)
