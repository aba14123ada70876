"""Recovery driving for recordings: a driver follows the line, is sometimes pushed off the line, and returns.

A network that has only seen the middle of the road has not learnt to return to it. The return is recorded, but not
the push: a network must not learn to leave the line. The clock advances during the push, so that the recording has
a gap in time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simulator.driving.course import Course
from simulator.driving.vehicle import STEP_S
from simulator.pose import Pose

PUSH_S = 1.0  # time of a push on the clock: with the time of a row, more than GAP_S of row_quality.py
MIN_PUSH, MAX_PUSH = 0.3, 0.8  # shares of the half width, to both sides
MAX_TURN_RAD = math.radians(25.0)
# A turned car moves farther to the side before it has steered back. The turn is limited, so that after this time
# the car would still be on the road.
_REACTION_S = 1.0
_ROOM = 0.9  # share of the half width

MAX_RECOVERY = 0.9  # share of the rows

# A recovery ends at this distance from the line and this heading error, or after this time. (In a bend with a
# radius of 12 m, the middle of a car has a heading error of 6 degrees when its rear axle has none.)
_BACK_OFFSET = 0.2
_BACK_TURN_RAD = math.radians(8.0)
_MAX_RECOVERY_S = 6.0
_USUAL_RECOVERY_S = 2.0


class SimulatedDriver(Protocol):
    """A driver of a course."""

    def control(self, course: Course) -> tuple[float, float]:
        """The command for the course's present state: steering -1 (left) .. 1 (right), throttle -1 .. 1. Called at
        every step of the simulator."""
        ...


@dataclass(frozen=True)
class DriveStep:
    """A recorded moment: the state of the car, and the driver's command."""

    time_s: float  # the simulated clock, 0 at the start
    steering: float  # -1 (left) .. 1 (right)
    throttle: float  # 0 .. 1
    brake: float  # 0 .. 1
    speed_mph: float
    pose: Pose
    progress_m: float  # along the road since the start
    offset: float  # from the centre line, as a share of the half width, positive to the left
    recovering: bool
    after_gap: bool  # the first step after a gap in the recording


def drive_for_recording(
    course: Course,
    driver: SimulatedDriver,
    laps: float,
    rate_hz: float = 10.0,
    recovery_share: float = 0.35,
    seed: int = 0,
) -> Iterator[DriveStep]:
    """Drive ``laps`` from the course's start, and yield ``rate_hz`` steps for each recorded second.

    About ``recovery_share`` (0 .. 0.9) of the steps are recoveries from random pushes at random places, which
    depend on ``seed``. No step is beyond ``laps``: a network trained on half a lap has never seen the other half.
    The driver steers at 50 Hz; ``rate_hz`` must divide 50.
    """
    steps = steps_each(rate_hz)
    if not 0.0 <= recovery_share <= MAX_RECOVERY:
        raise ValueError(f"recovery_share must be within 0 .. {MAX_RECOVERY:g}, not {recovery_share:g}")
    if laps <= 0:
        raise ValueError(f"laps must be above 0, not {laps:g}")
    return _drive(course, driver, laps * course.line.length_m, steps, recovery_share, seed)


def steps_each(rate_hz: float) -> int:
    """The number of simulator steps for each recorded or sent step. Raises ValueError if it is not an integer."""
    steps = round(1.0 / (rate_hz * STEP_S)) if rate_hz > 0 else 0
    if steps < 1 or abs(steps * STEP_S * rate_hz - 1.0) > 1e-6:
        raise ValueError(f"--rate {rate_hz:g}: it must divide {1 / STEP_S:g} (as 5, 10, 12.5, 25 do)")
    return steps


def _drive(
    course: Course, driver: SimulatedDriver, end_m: float, steps_each: int, share: float, seed: int
) -> Iterator[DriveStep]:
    random = np.random.default_rng(seed)
    course.start()
    recovering_since_s: float | None = None
    next_push_s = _undisturbed_s(random, share, _USUAL_RECOVERY_S)
    after_gap = False
    while course.progress_m <= end_m:
        if recovering_since_s is not None and _has_recovered(course, recovering_since_s):
            next_push_s = course.time_s + _undisturbed_s(random, share, course.time_s - recovering_since_s)
            recovering_since_s = None
        if recovering_since_s is None and course.time_s >= next_push_s:
            _push(course, random)
            recovering_since_s, after_gap = course.time_s, True
        if course.off_road:
            # Not recorded either: a person would stop the recording, drive back, and continue.
            course.displace(0.0, 0.0, PUSH_S)
            recovering_since_s, after_gap = None, True
            next_push_s = max(next_push_s, course.time_s + _USUAL_RECOVERY_S)
        steering, throttle = driver.control(course)
        yield DriveStep(
            time_s=course.time_s,
            steering=steering,
            throttle=max(0.0, throttle),
            brake=max(0.0, -throttle),
            speed_mph=course.vehicle.speed_mph,
            pose=course.pose,
            progress_m=course.progress_m,
            offset=course.offset,
            recovering=recovering_since_s is not None,
            after_gap=after_gap,
        )
        after_gap = False
        course.advance(steering, throttle)
        for _ in range(steps_each - 1):
            course.advance(*driver.control(course))


def _undisturbed_s(random: np.random.Generator, share: float, recovery_s: float) -> float:
    """A random time until the next push, so that a recovery of ``recovery_s`` is ``share`` of the whole time."""
    if share == 0.0:
        return math.inf
    return recovery_s * (1.0 - share) / share * random.uniform(0.5, 1.5)


def _push(course: Course, random: np.random.Generator) -> None:
    """Move the car to a random offset from the line, with a random turn."""
    side = random.choice([-1.0, 1.0])
    offset_m = side * random.uniform(MIN_PUSH, MAX_PUSH) * course.half_width_m
    turn = random.uniform(-MAX_TURN_RAD, MAX_TURN_RAD)
    room_m = _ROOM * course.half_width_m - math.copysign(offset_m, offset_m * turn)
    max_turn_rad = room_m / max(1.0, course.vehicle.speed_mps * _REACTION_S)
    course.displace(offset_m, max(-max_turn_rad, min(max_turn_rad, turn)), PUSH_S)


def _has_recovered(course: Course, since_s: float) -> bool:
    if course.time_s - since_s >= _MAX_RECOVERY_S:
        return True
    return abs(course.offset) <= _BACK_OFFSET and abs(course.heading_error_rad) <= _BACK_TURN_RAD
