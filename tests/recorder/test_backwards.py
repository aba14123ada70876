"""A car driven backwards is found by its numbers: measured against the truth of the simulator."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import pytest

from recorder.rows.odd_stretches import odd_stretches
from recorder.rows.row_quality import States
from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.roads.track import load_track

STEPS_A_ROW = 5  # 10 rows a second


@dataclass
class Driven:
    """The numbers of a drive as Udacity's simulator writes them, whose speed has no sign, and the truth."""

    numbers: list[tuple[float, float, float, float]] = field(default_factory=list)
    speed_mph: list[float] = field(default_factory=list)

    def add(self, steering: float, throttle: float, speed_mph: float) -> None:
        self.numbers.append((steering, max(0.0, throttle), max(0.0, -throttle), abs(speed_mph)))
        self.speed_mph.append(speed_mph)

    @property
    def states(self) -> States:
        steering, throttle, brake, speed = np.array(self.numbers).T
        rows = np.arange(len(speed))
        return States(rows, rows * 100_000_000, steering, throttle, brake, speed)


def pedals(track: str, throttles: Iterable[tuple[float, float]], start: float = 0.0) -> Driven:
    """A drive by these throttles, each held for so many seconds."""
    course, driven = Course(load_track(track)), Driven()
    course.start(start * load_track(track).line.length_m)
    for throttle, seconds in throttles:
        for step in range(round(seconds * 50)):
            course.advance(0.0, throttle)
            if step % STEPS_A_ROW == 0:
                driven.add(0.0, throttle, course.vehicle.speed_mph)
    return driven


THERE_AND_BACK = [(1.0, 3.0), (-1.0, 8.0), (0.0, 1.0), (1.0, 4.0)]


def test_what_was_driven_backwards_is_found_without_a_sign_of_speed() -> None:
    driven = pedals("lake", THERE_AND_BACK)
    truth = np.array(driven.speed_mph) < -0.5
    backwards = driven.states.flags["backwards"]
    assert truth.sum() > 30
    assert (backwards != truth).sum() <= 3  # where it stands


@pytest.mark.parametrize("track", ["lake", "mountain", "random:1"])
def test_nothing_of_a_fast_expert_is_odd(track: str) -> None:
    road = load_track(track)
    course, driven, expert = Course(road), Driven(), Expert(road.line, 30.0, 0.03, 0)
    course.start()
    for step in range(50 * 40):
        steering, throttle = expert.control(course)
        course.advance(steering, throttle)
        if step % STEPS_A_ROW == 0:
            driven.add(steering, throttle, course.vehicle.speed_mph)
    assert odd_stretches(driven.states) == []


@pytest.mark.parametrize("start", [0.1, 0.3, 0.5, 0.7])
def test_braking_and_rolling_on_hills_is_not_driving_backwards(start: float) -> None:
    driven = pedals("mountain", [(1.0, 3.0), (0.0, 3.0), (1.0, 3.0), (-0.3, 1.0), (1.0, 2.0)], start)
    assert min(driven.speed_mph) >= -0.5
    assert not driven.states.flags["backwards"].any()
