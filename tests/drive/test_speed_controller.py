"""A target speed that changes all the time is followed: up and down, on slopes, and by a car that was put back.
A set speed is held without winding up."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from common.car import MPS_PER_MPH
from drive.control.speed_controller import SpeedController
from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.driving.vehicle import STEP_S, CarState, step
from simulator.roads.track import Track, load_track

RATE_S = 0.04
Floats = NDArray[np.float64]


def experts_lap(track: Track, mph: float) -> tuple[Floats, Floats, Floats]:
    """Time in s, progress in m and speed in mph of the expert, who knows the road ahead."""
    course, expert, rows = Course(track), Expert(track.line, mph), []
    while course.laps < 1.05:
        rows.append((course.time_s, course.progress_m, course.vehicle.speed_mph))
        course.advance(*expert.control(course), RATE_S)
    times, progress, speeds = np.array(rows).T
    return times, progress, speeds


def test_the_experts_30_mph_are_followed_through_the_mountains_hairpins() -> None:
    """The target is what the expert drives half a second after this place; commands act one telemetry late."""
    track = load_track("mountain")
    times, progress, speeds = experts_lap(track, 30)
    course, expert, controller = Course(track), Expert(track.line, 30), SpeedController(30)
    errors, command = [], (0.0, 0.0)
    while course.laps < 1:
        there_s = np.interp(course.progress_m, progress, times)
        target_mph = float(np.interp(there_s + 0.5, times, speeds))
        steering, _ = expert.control(course)
        answer = steering, controller.follow(course.time_s, course.vehicle.speed_mph, target_mph)
        errors.append(course.vehicle.speed_mph - float(np.interp(there_s, times, speeds)))
        course.advance(*command, RATE_S)
        command = answer
        assert course.time_s < 150
    moving = np.array(errors[200:])
    assert np.ptp(speeds) > 20  # from 30 mph down to a hairpin's 13
    assert float(np.sqrt((moving**2).mean())) < 0.5
    assert float(np.abs(moving).max()) < 1.5
    assert course.measures.max_offset < 0.2


def drive(controller: SpeedController, target_mph: float, slope: float, car: CarState, seconds: float) -> CarState:
    for k in range(round(seconds / RATE_S)):
        throttle = controller.follow(k * RATE_S, car.speed_mph, target_mph)
        for _ in range(round(RATE_S / STEP_S)):
            car = step(car, 0.0, throttle, slope)
    return car


@pytest.mark.parametrize("slope", [-0.13, 0.0, 0.13])
@pytest.mark.parametrize("target_mph", [5, 25])
def test_a_target_is_held_on_slopes(target_mph: float, slope: float) -> None:
    at_rest = CarState(0.0, 0.0, 0.0)
    assert drive(SpeedController(30), target_mph, slope, at_rest, 12).speed_mph == pytest.approx(
        target_mph, abs=0.2
    )


@pytest.mark.parametrize("slope", [-0.13, 0.0, 0.13])
def test_a_target_that_falls_is_reached_within_two_seconds(slope: float) -> None:
    controller, fast = SpeedController(30), CarState(0.0, 0.0, 0.0, 30 * MPS_PER_MPH)
    assert drive(controller, 8, slope, fast, 3.0).speed_mph == pytest.approx(
        8, abs=0.7
    )  # 1.5 s of it at full brake


def test_no_target_is_followed_beyond_the_set_speed_nor_below_a_stand() -> None:
    at_rest = CarState(0.0, 0.0, 0.0)
    assert drive(SpeedController(10), 30, 0.0, at_rest, 10).speed_mph == pytest.approx(10, abs=0.1)
    stopped = drive(SpeedController(10), -5, 0.0, CarState(0.0, 0.0, 0.0, 4.0), 10)
    assert 0.0 <= stopped.speed_mph < 1.5


def test_a_car_that_was_put_back_at_rest_is_not_taken_for_one_on_a_slope() -> None:
    controller = SpeedController(30)
    drive(controller, 20, 0.0, CarState(0.0, 0.0, 0.0, 20 * MPS_PER_MPH), 4)
    fresh = SpeedController(30)
    assert controller.follow(4.0, 0.0, 5.0) == pytest.approx(fresh.follow(0.0, 0.0, 5.0), abs=0.01)


def test_the_speed_that_is_reported_is_the_lowest_of_those_wanted() -> None:
    assert SpeedController(20).set_speed_for(0.5) == 20
    assert SpeedController(20).set_speed_for(0.5, 15.0) == 15
    assert SpeedController(20).set_speed_for(0.5, 25.0) == 20
    slow = SpeedController(20, slow_in_curves=True)
    assert slow.set_speed_for(0.5, 15.0) == slow.set_speed_for(0.5) < 15
    assert slow.set_speed_for(0.0, 15.0) == 15
    assert math.isclose(slow.set_speed_for(0.5, 3.0), 3.0)


def test_what_a_bend_takes_off_is_not_missing_on_the_straight_behind_it() -> None:
    plain, slowed = SpeedController(20), SpeedController(20, slow_in_curves=True)
    plain.throttle(20.0)
    slowed.throttle(20.0)
    for _ in range(100):  # faster in the bend than it wants to be
        slowed.throttle(18.0, steering=0.8)
    assert slowed.set_speed_for(0.8) < 18
    assert slowed.throttle(19.0) == plain.throttle(19.0)


def test_the_first_throttles_are_those_of_the_formula() -> None:
    """0.1 a mph too slow, and 0.002 a mph summed over the telemetries so far, this one included."""
    controller = SpeedController(9.0)
    assert controller.throttle(4.0) == pytest.approx(0.1 * 5 + 0.002 * 5)
    assert controller.throttle(6.0) == pytest.approx(0.1 * 3 + 0.002 * (5 + 3))
    assert controller.throttle(10.0) == pytest.approx(0.1 * -1 + 0.002 * (5 + 3 - 1))


@pytest.mark.parametrize("telemetries", [1_000, 10_000])
def test_a_long_climb_does_not_wind_up_a_throttle_that_outlasts_it(telemetries: int) -> None:
    controller = SpeedController(10.0)
    for _ in range(telemetries):
        throttle = controller.throttle(2.0)
    assert throttle == 1.0
    # 3 mph too fast takes 0.3 off at once, and 0.006 more with each telemetry, off an integral of at most 0.5
    after = [controller.throttle(13.0) for _ in range(60)]
    assert after[0] <= 0.5 - 0.3
    assert after == sorted(after, reverse=True)
    assert next(i for i, throttle in enumerate(after) if throttle < 0) <= math.ceil(0.2 / 0.006)


@given(st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=50), st.floats(0, 100))
def test_the_throttle_for_a_set_speed_stays_within_its_bounds(
    speeds_mph: list[float], set_speed_mph: float
) -> None:
    controller = SpeedController(set_speed_mph)
    assert all(-1 <= controller.throttle(speed_mph) <= 1 for speed_mph in speeds_mph)
