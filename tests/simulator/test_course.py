"""The book of a drive cannot be cheated, and says what its formulas say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.driving.course import STUCK_S, Course
from simulator.driving.vehicle import MAX_WHEEL_RAD, wheel_angle_for
from simulator.roads.centreline import Centreline
from simulator.roads.track import Track

RADIUS_M = 30.0
HALF_WIDTH_M = 4.0


def closed_road(points_m: NDArray[np.float64], half_width_m: float = HALF_WIDTH_M) -> Track:
    line = Centreline(points_m)
    count = len(line.points_m)
    return Track("road", line, np.full(count, half_width_m), (), np.zeros(count, np.intp))


def ring(tilt: float = 0.0) -> Track:
    """A circle driven to the left, from (30, 0) north; ``tilt`` is the slope of its plane to the north."""
    angle = np.linspace(0, math.tau, 720, endpoint=False)
    x, y = RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle)
    return closed_road(np.stack([x, y, tilt * y], axis=1))


def stadium(straight_m: float = 60.0, radius_m: float = 8.0) -> Track:
    """Two straights, side by side, and two half circles, driven to the left."""
    half = np.linspace(0, math.pi, 60, endpoint=False)
    along = np.arange(0, straight_m, 0.5)
    x = np.concatenate([along, straight_m + radius_m * np.sin(half), straight_m - along, -radius_m * np.sin(half)])
    y = np.concatenate(
        [0 * along, radius_m * (1 - np.cos(half)), 0 * along + 2 * radius_m, radius_m * (1 + np.cos(half))]
    )
    return closed_road(np.stack([x, y, 0 * x], axis=1), 3.0)


def keep_to_the_ring(course: Course, throttle: float, seconds: float) -> None:
    """Steers the ring's curvature, corrected by offset and heading."""
    for _ in range(round(seconds / 0.02)):
        error = course.heading_error_rad
        curvature = 1 / RADIUS_M - 0.05 * course.offset_m - 0.4 * error
        wheel = wheel_angle_for(curvature, course.vehicle.speed_mps)
        course.advance(-wheel / MAX_WHEEL_RAD, throttle)


def test_it_starts_at_rest_on_the_line_where_it_is_reported_to() -> None:
    course = Course(ring())
    course.start(arc_m=RADIUS_M * math.pi / 2)
    assert (course.vehicle.x_m, course.vehicle.y_m) == pytest.approx((0.0, RADIUS_M), abs=0.05)
    assert course.vehicle.heading_rad == pytest.approx(math.pi, abs=0.02)
    assert (course.vehicle.speed_mps, course.offset_m, course.laps) == (0.0, 0.0, 0.0)


def test_laps_are_the_angle_gone_round() -> None:
    course = Course(ring())
    angle, before = 0.0, 0.0
    while course.whole_laps < 2:
        keep_to_the_ring(course, 0.3, 0.1)
        now = math.atan2(course.vehicle.y_m, course.vehicle.x_m)
        angle += math.remainder(now - before, math.tau)
        before = now
        assert course.laps == pytest.approx(angle / math.tau, abs=0.005)
    assert course.measures.distance_m == pytest.approx(2 * math.tau * RADIUS_M, rel=0.02)
    assert course.measures.interventions == 0


def test_reversing_over_the_line_gains_no_lap() -> None:
    course = Course(ring())
    for _ in range(3):
        for throttle in (-0.5, 0.3):
            course.advance(0.0, throttle, 4.0)
            assert course.whole_laps == 0
    course.start()
    course.advance(0.0, -1.0, 3.0)
    assert course.laps < -0.01


def test_a_lap_that_is_crossed_twice_counts_once() -> None:
    course = Course(ring())
    while course.whole_laps < 1:
        keep_to_the_ring(course, 0.2, 0.1)
    course.advance(0.0, -1.0, 9.0)
    assert course.laps < 0.99
    assert course.whole_laps == 1
    keep_to_the_ring(course, 0.2, 6.0)
    assert 1.0 < course.laps < 1.5
    assert course.whole_laps == 1


def test_cutting_from_one_straight_to_the_other_gains_nothing() -> None:
    course = Course(stadium())
    course.start(arc_m=52.0)
    left_the_road = False
    for _ in range(400):  # across to the other straight, which is 16 m to the left, and along it
        car = course.vehicle
        wanted = math.pi if car.y_m > 10.0 else math.pi / 2
        correction = 0.1 * (car.y_m - 16.0) if car.y_m > 10.0 else 0.0
        course.advance(-2.0 * (wanted + correction - car.heading_rad), 0.7 if car.speed_mps < 4.0 else 0.0)
        left_the_road |= course.off_road
    assert left_the_road
    assert not course.off_road
    # Of the road between the start and here it drove only what lay on the two straights.
    assert course.arc_m > 90.0
    assert 0.0 < course.progress_m < course.measures.distance_m
    assert course.arc_m - 52.0 - course.progress_m > 15.0


def test_off_the_road_is_farther_than_the_half_width() -> None:
    course = Course(ring())
    course.displace(0.99 * HALF_WIDTH_M, 0.0, 0.0)
    assert not course.off_road
    course.displace(-1.01 * HALF_WIDTH_M, 0.0, 0.0)
    assert course.off_road
    assert course.intervention_due
    assert course.offset == pytest.approx(-1.01)


def test_an_intervention_puts_the_car_back_where_it_left_the_road() -> None:
    course = Course(ring())
    while not course.off_road:
        course.advance(0.0, 0.5)  # straight on
    left_at = math.atan2(course.vehicle.y_m, course.vehicle.x_m)
    laps = course.laps
    course.intervene()
    car = course.vehicle
    assert math.hypot(car.x_m, car.y_m) == pytest.approx(RADIUS_M, abs=0.05)
    assert math.atan2(car.y_m, car.x_m) == pytest.approx(left_at, abs=0.02)
    assert car.heading_rad == pytest.approx(left_at + math.pi / 2, abs=0.03)
    assert (car.speed_mps, course.offset_m, course.laps) == (0.0, 0.0, laps)
    assert not course.intervention_due
    assert course.measures.interventions == 1
    assert course.measures.max_offset > 1.0


@pytest.mark.parametrize("throttle", [0.0, -1.0])
def test_standing_and_driving_backwards_are_stuck(throttle: float) -> None:
    course = Course(ring())
    course.advance(0.0, throttle, STUCK_S - 0.1)
    assert not course.stuck
    course.advance(0.0, throttle, 0.1)
    assert course.stuck
    course.intervene()
    assert not course.stuck


def test_autonomy_loses_six_seconds_for_each_intervention() -> None:
    course = Course(ring())
    keep_to_the_ring(course, 0.1, 60.0)
    assert course.measures.autonomy_percent == 100.0
    course.intervene()
    assert course.measures.autonomy_percent == pytest.approx(90.0)
    for _ in range(20):
        course.intervene()
    assert course.measures.autonomy_percent == 0.0


def test_measures_of_a_straight_push_and_a_known_steering() -> None:
    course = Course(ring())
    for steering in (0.1, -0.1, 0.1, -0.1):  # travels 0.1 + 3 * 0.2 in 0.4 s
        course.advance(steering, 0.0, 0.1)
    assert course.measures.steering_per_s == pytest.approx(0.7 / 0.4)
    assert course.measures.elapsed_s == pytest.approx(0.4)
    course.start()
    course.displace(0.5 * HALF_WIDTH_M, 0.0, 0.0)
    course.advance(0.0, 0.0, 1.0)
    measures = course.measures
    assert (measures.mean_offset, measures.max_offset) == pytest.approx((0.5, 0.5), abs=0.01)
    assert (measures.mean_speed_mph, measures.steering_per_s) == (0.0, 0.0)


def test_the_clock_runs_on_while_the_car_is_displaced() -> None:
    course = Course(ring())
    course.advance(0.0, 0.0, 0.5)
    course.displace(1.0, 0.2, 2.0)
    assert course.time_s == pytest.approx(2.5)
    assert course.measures.elapsed_s == pytest.approx(0.5)
    assert course.offset_m == 1.0
    assert course.heading_error_rad == pytest.approx(0.2)


def test_the_pose_stands_on_the_ground_behind_the_cars_middle() -> None:
    course = Course(ring(), height_m=lambda x, y: 5.0 + 0.12 * y + 0.05 * x)
    pose = course.pose  # at (30, 0), heading north
    assert (pose.x_m, pose.y_m) == pytest.approx((30.0, -1.3), abs=0.05)
    assert pose.z_m == pytest.approx(5.0 - 0.12 * 1.3 + 1.5, abs=0.01)
    assert pose.pitch_rad == pytest.approx(math.atan(0.12), abs=0.002)
    assert pose.roll_rad == pytest.approx(-math.atan(0.05), abs=0.002)  # the ground rises to the right
