"""The expert keeps to the line at the speed it is set, and what is recorded of it is a drive worth learning."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from common.car import MPS_PER_MPH
from simulator.driving.course import Course
from simulator.driving.expert import BEND_MPS2, Expert, plan_speed
from simulator.driving.recovery_driving import PUSH_S, DriveStep, drive_for_recording
from simulator.roads.centreline import Centreline
from simulator.roads.track import Track


def road(*stretches: tuple[float, float], half_width_m: float = 4.0, slope: float = 0.0) -> Track:
    """Arcs of (length in m, turn to the left in degrees) that close; it climbs and falls by ``slope`` at most."""
    points, place, heading = [], 0j, 0.0
    for length_m, turn in stretches:
        count = round(length_m / 0.25)
        for _ in range(count):
            points.append(place)
            heading += math.radians(turn) / count / 2
            place += length_m / count * complex(math.cos(heading), math.sin(heading))
            heading += math.radians(turn) / count / 2
    plane = np.array(points)
    height = slope * len(plane) * 0.25 / math.tau * np.sin(np.linspace(0, math.tau, len(plane), False))
    line = Centreline(np.stack([plane.real, plane.imag, height], axis=1))
    count = len(line.points_m)
    return Track("road", line, np.full(count, half_width_m), (), np.zeros(count, np.intp))


OVAL = road((120, 0), (40 * math.pi, 180), (120, 0), (40 * math.pi, 180))
HAIRPINS = road(  # of 12 m, both ways, at 12 %, with two narrow lanes
    (60, 0),
    (12 * math.pi, 180),
    (40, 0),
    (12 * math.pi, -180),
    (40, 0),
    (12 * math.pi, 180),
    (60, 0),
    (36 * math.pi, 180),
    half_width_m=3.8,
    slope=0.12,
)


@pytest.mark.parametrize("mph", [10, 30])
@pytest.mark.parametrize("track", [OVAL, HAIRPINS], ids=["oval", "hairpins"])
def test_a_lap_stays_near_the_line(track: Track, mph: float) -> None:
    course, expert = Course(track), Expert(track.line, mph)
    while course.whole_laps < 1:
        course.advance(*expert.control(course))
        assert course.measures.elapsed_s < 120
    assert course.measures.max_offset < 0.2
    assert course.measures.interventions == 0
    assert course.measures.steering_per_s < 0.2


@pytest.mark.parametrize(("mph", "slope"), [(10, 0.12), (20, 0.12), (20, -0.12)])
def test_it_holds_its_speed_on_slopes(mph: float, slope: float) -> None:
    track = road((600, 0), (40 * math.pi, 180), (600, 0), (40 * math.pi, 180), slope=slope)
    course, expert = Course(track), Expert(track.line, mph)
    for _ in range(800):
        course.advance(*expert.control(course))
    assert course.vehicle.speed_mph == pytest.approx(mph, abs=0.5)


def test_it_brakes_before_the_bend_and_not_in_it() -> None:
    speed = plan_speed(HAIRPINS.line, 30 * MPS_PER_MPH)
    bend = 60 + 6 * math.pi  # the first hairpin's middle
    at = [float(speed[round(arc / HAIRPINS.line.step_m)]) for arc in (bend - 40, bend - 25, bend)]
    assert at[0] > at[1] > at[2]
    assert at[2] == pytest.approx(math.sqrt(BEND_MPS2 * 12), rel=0.03)
    slowed = -np.diff(speed**2) / (2 * HAIRPINS.line.step_m)
    assert slowed.max() <= 2.0 + 1e-6


@pytest.mark.parametrize("mph", [1e6, 1e200])
def test_no_set_speed_is_so_high_that_planning_takes_for_ever(mph: float) -> None:
    assert plan_speed(HAIRPINS.line, mph * MPS_PER_MPH).max() == plan_speed(HAIRPINS.line, 100.0).max()


def test_noise_wanders_by_its_deviation_without_leaving_the_line_far() -> None:
    course = Course(OVAL)
    noisy, calm = Expert(OVAL.line, 10, noise=0.03, seed=1), Expert(OVAL.line, 10)
    added = []
    while course.laps < 1:
        steering, throttle = noisy.control(course)
        added.append(steering - calm.control(course)[0])
        course.advance(steering, throttle)
    assert np.std(added) == pytest.approx(0.03, rel=0.3)
    assert np.abs(np.diff(added)).max() < 0.02  # no jerks
    assert course.measures.max_offset < 0.3


def record(
    track: Track, laps: float = 0.5, mph: float = 10, seed: int = 1, share: float = 0.35
) -> list[DriveStep]:
    expert = Expert(track.line, mph, noise=0.02, seed=seed)
    return list(drive_for_recording(Course(track), expert, laps, recovery_share=share, seed=seed))


def recoveries(steps: list[DriveStep]) -> list[list[DriveStep]]:
    """The steps from each gap to the end of the recovery that follows it."""
    starts = [i for i, step in enumerate(steps) if step.after_gap]
    ends = [*starts[1:], len(steps)]
    return [
        list(itertools.takewhile(lambda step: step.recovering, steps[i:j]))
        for i, j in zip(starts, ends, strict=True)
    ]


@pytest.mark.parametrize("mph", [10, 30])
@pytest.mark.parametrize("track", [OVAL, HAIRPINS], ids=["oval", "hairpins"])
def test_every_recovery_comes_back_to_the_line_and_stays_on_the_road(track: Track, mph: float) -> None:
    recovered = recoveries(record(track, laps=1, mph=mph))
    assert len(recovered) > 5
    for steps in recovered[:-1]:  # the end of the drive may cut the last one short
        assert abs(steps[0].offset) > 0.25
        assert abs(steps[-1].offset) < abs(steps[0].offset)
        assert abs(steps[-1].offset) < 0.35
        assert max(abs(step.offset) for step in steps) < 0.95


def test_on_a_straight_the_first_command_steers_back_to_the_line() -> None:
    track = road((500, 0), (40 * math.pi, 180), (500, 0), (40 * math.pi, 180))
    pointed_m = []
    for steps in recoveries(record(track, laps=0.38)):
        pushed = steps[0]
        # The place it points to 7 m ahead is left of the line: it steers right, and the other way round.
        ahead_m = pushed.offset * 4.0 + 7.0 * math.sin(math.remainder(pushed.pose.heading_rad, math.tau))
        if abs(ahead_m) > 1.0:
            assert math.copysign(1, pushed.steering) == math.copysign(1, ahead_m)
            pointed_m.append(ahead_m)
    assert min(pointed_m) < 0 < max(pointed_m)


def test_what_is_recorded_ends_with_the_laps_asked_for() -> None:
    for laps in (0.5, 1.25):
        steps = record(HAIRPINS, laps=laps)
        assert all(-0.1 <= step.progress_m <= laps * HAIRPINS.line.length_m for step in steps)
        assert steps[-1].progress_m > laps * HAIRPINS.line.length_m - 2.0


def test_the_share_of_recoveries_is_the_one_asked_for() -> None:
    for share in (0.2, 0.5):
        steps = record(OVAL, laps=1.5, share=share)
        assert np.mean([step.recovering for step in steps]) == pytest.approx(share, abs=0.06)
    assert not any(step.recovering or step.after_gap for step in record(OVAL, share=0.0))


def test_gaps_are_seen_in_time_and_nowhere_else() -> None:
    steps = record(OVAL)
    for before, after in itertools.pairwise(steps):
        expected = 0.1 + (PUSH_S if after.after_gap else 0.0)
        assert after.time_s - before.time_s == pytest.approx(expected)


def test_the_same_seed_is_the_same_drive_bit_for_bit() -> None:
    assert record(HAIRPINS, seed=5) == record(HAIRPINS, seed=5)
    assert record(HAIRPINS, seed=5) != record(HAIRPINS, seed=6)


def test_values_are_those_of_the_simulators_own_rows() -> None:
    for step in record(HAIRPINS, mph=30):
        assert -1 <= step.steering <= 1
        assert 0 <= step.throttle <= 1
        assert 0 <= step.brake <= 1
        assert step.throttle == 0 or step.brake == 0


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("rate_hz", 15.0, "--rate 15"),
        ("rate_hz", 0.0, "--rate 0"),
        ("recovery_share", 1.0, "recovery"),
        ("laps", 0.0, "laps must be above 0"),
    ],
)
def test_a_recording_that_cannot_be_driven_is_refused(name: str, value: float, error: str) -> None:
    arguments = {"laps": 1.0, name: value}
    with pytest.raises(ValueError, match=error):
        drive_for_recording(Course(OVAL), Expert(OVAL.line, 10), **arguments)  # type: ignore[arg-type]
