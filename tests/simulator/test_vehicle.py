"""The car obeys the formulas of a bicycle model where they hold, and grip where they do not."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.car import MPS_PER_MPH
from simulator.driving.vehicle import (
    AXLE_TO_CENTRE_M,
    BRAKE_MPS2,
    DRAG_PER_S,
    GRAVITY_MPS2,
    GRIP,
    MAX_WHEEL_RAD,
    ROLLING_MPS2,
    STEERING_RATE_RADPS,
    STEP_S,
    WHEELBASE_M,
    CarState,
    step,
    wheel_angle_for,
)

AT_REST = CarState(0.0, 0.0, 0.0)


def hold(
    state: CarState,
    steering: float,
    throttle: float,
    seconds: float,
    slope: float = 0.0,
    off_road: bool = False,
) -> CarState:
    for _ in range(round(seconds / STEP_S)):
        state = step(state, steering, throttle, slope, off_road)
    return state


def moving(speed_mps: float, steering: float = 0.0) -> CarState:
    return CarState(0.0, 0.0, 0.0, speed_mps, wheel_angle_rad=-steering * MAX_WHEEL_RAD)


def circle_radius_m(speed_mps: float, steering: float) -> float:
    """Of the circle through three places of a car that holds its speed and wheels."""
    throttle = (DRAG_PER_S * speed_mps + ROLLING_MPS2) / 5.3
    car = hold(moving(speed_mps, steering), steering, throttle, 3.0)
    places = []
    for _ in range(3):
        places.append(complex(car.x_m, car.y_m))
        car = hold(car, steering, throttle, 1.0)
    a, b, c = places
    area = abs(((b - a).conjugate() * (c - a)).imag) / 2
    return abs(a - b) * abs(b - c) * abs(c - a) / (4 * area)


@pytest.mark.parametrize("steering", [-1.0, -0.4, 0.2, 1.0])
def test_at_walking_pace_the_rear_axle_turns_on_wheelbase_over_tangent(steering: float) -> None:
    rear_axle = WHEELBASE_M / math.tan(abs(steering) * math.radians(25))
    assert circle_radius_m(1.0, steering) == pytest.approx(math.hypot(rear_axle, AXLE_TO_CENTRE_M), rel=0.01)


def test_the_same_wheel_angle_turns_wider_at_speed() -> None:
    slow, fast = (circle_radius_m(mph * MPS_PER_MPH, 0.3) for mph in (10, 30))
    assert fast > 1.3 * slow


@given(
    st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.integers(1, 60)), min_size=1, max_size=8),
    st.floats(-0.15, 0.15),
)
def test_no_command_takes_more_than_the_grip(commands: list[tuple[float, float, int]], slope: float) -> None:
    car = moving(12.0)
    for steering, throttle, steps in commands:
        for _ in range(steps):
            car = step(car, steering, throttle, slope)
            assert abs(car.speed_mps * car.yaw_rate_radps) <= GRIP * GRAVITY_MPS2 + 1e-9
            assert abs(car.wheel_angle_rad) <= MAX_WHEEL_RAD + 1e-9


def test_braking_takes_grip_from_the_bend() -> None:
    """The friction circle: of the grip, braking by b leaves sqrt(grip² - b²)."""
    fast = CarState(0.0, 0.0, 0.0, 13.0, wheel_angle_rad=MAX_WHEEL_RAD, yaw_rate_radps=GRIP * GRAVITY_MPS2 / 13.0)
    braking = step(fast, -1.0, -1.0)
    left_mps2 = math.sqrt((GRIP * GRAVITY_MPS2) ** 2 - BRAKE_MPS2**2)
    assert braking.yaw_rate_radps == pytest.approx(left_mps2 / braking.speed_mps)
    rolling = step(fast, -1.0, 0.0)
    assert rolling.yaw_rate_radps > 1.01 * braking.yaw_rate_radps


def test_right_steering_turns_right_and_left_turns_left() -> None:
    right, left = (hold(moving(5.0), steering, 0.2, 1.0) for steering in (0.5, -0.5))
    assert right.heading_rad < 0
    assert right.y_m < 0
    assert (left.heading_rad, left.y_m) == pytest.approx((-right.heading_rad, -right.y_m))
    assert right.steering == pytest.approx(0.5, abs=0.01)


def test_in_a_fast_bend_the_nose_points_into_it() -> None:
    car = hold(moving(12.0), -0.2, 0.4, 2.0)
    after = step(car, -0.2, 0.4)
    course = math.atan2(after.y_m - car.y_m, after.x_m - car.x_m)
    assert 0.0 < math.remainder(after.heading_rad - course, math.tau) < math.radians(5)


def test_the_wheels_follow_late_and_no_faster_than_their_rate() -> None:
    angles = [0.0]
    car = moving(5.0)
    for _ in range(50):
        car = step(car, -1.0, 0.2)
        angles.append(car.wheel_angle_rad)
    rates = [(b - a) / STEP_S for a, b in itertools.pairwise(angles)]
    assert max(rates) <= STEERING_RATE_RADPS + 1e-9
    assert angles[10] < 0.6 * MAX_WHEEL_RAD  # after 0.2 s
    assert angles[-1] == pytest.approx(MAX_WHEEL_RAD, rel=0.01)


def test_it_accelerates_as_in_recordings() -> None:
    """Published recordings: 5 to 25 mph at full throttle in 1.9 s (4.3 .. 4.9 m/s² on the way)."""
    car, seconds = moving(5 * MPS_PER_MPH), 0.0
    while car.speed_mph < 25:
        car, seconds = step(car, 0.0, 1.0), seconds + STEP_S
    assert seconds == pytest.approx(1.9, abs=0.15)


def test_it_brakes_by_the_formula_of_brake_drag_and_rolling() -> None:
    speed = 12.0
    car = moving(speed)
    while car.speed_mps > 0:
        car = step(car, 0.0, -1.0)
    # dv/dt = -(b + k v)  =>  distance = v/k - b/k² ln(1 + k v / b)
    b, k = BRAKE_MPS2 + ROLLING_MPS2, DRAG_PER_S
    assert car.x_m == pytest.approx(speed / k - b / k**2 * math.log(1 + k * speed / b), abs=0.2)


def test_a_negative_throttle_stops_the_car_and_then_reverses_it_slowly() -> None:
    backwards = hold(moving(5.0), 0.0, -1.0, 10.0)
    assert -5.0 < backwards.speed_mph < -3.0
    assert hold(AT_REST, 0.0, -1.0, 0.5).speed_mph > -2.5


def test_a_car_left_alone_comes_to_rest_and_stays() -> None:
    resting = hold(moving(5.0), 0.0, 0.0, 60.0)
    assert resting.speed_mps == 0.0
    assert hold(resting, 1.0, 0.0, 1.0).heading_rad == pytest.approx(resting.heading_rad)


def test_climbing_slows_and_descending_hastens() -> None:
    up, level, down = (hold(AT_REST, 0.0, 0.3, 5.0, slope).speed_mps for slope in (0.12, 0.0, -0.12))
    # The first 5 s of dv/dt = a - k v from rest: v = a / k (1 - exp(-5 k)).
    gravity = GRAVITY_MPS2 * math.sin(math.atan(0.12))
    assert level - up == pytest.approx(gravity / DRAG_PER_S * (1 - math.exp(-5 * DRAG_PER_S)), rel=0.02)
    assert up < level < down


@pytest.mark.parametrize("speed_mps", [1.0, 5.0, 10.0])
def test_the_wheel_angle_for_a_bend_drives_that_bend(speed_mps: float) -> None:
    steering = -wheel_angle_for(1 / 40.0, speed_mps) / MAX_WHEEL_RAD
    assert steering < 0  # a positive curvature turns left
    assert circle_radius_m(speed_mps, steering) == pytest.approx(40.0, rel=0.05)
