"""A car on a track, and the measures of its drive: laps, distance from the centre line, interventions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from common.car import MPS_PER_MPH
from simulator.driving.vehicle import AXLE_TO_CENTRE_M, STEP_S, WHEELBASE_M, CarState, step
from simulator.pose import Pose
from simulator.roads.centreline import Centreline
from simulator.roads.track import Track

INTERVENTION_COST_S: Final = 6.0
"""Time in which a person takes over, steers back and restarts the system: Bojarski et al. 2016 (arXiv 1604.07316),
section 7.1."""


def autonomy_percent(interventions: int, driven_s: float) -> float:
    """The autonomy in percent (0..100) over `driven_s` seconds, which must be more than 0."""
    return 100.0 * max(0.0, 1.0 - INTERVENTION_COST_S * interventions / driven_s)


Height = Callable[[float, float], float]  # the ground's height in metres at (x_m, y_m)

WHEEL_TRACK_M = 1.6  # between the left and the right wheels
STUCK_S = 5.0  # without a metre of progress for this long, the car is stuck
_STUCK_PROGRESS_M = 1.0


@dataclass(frozen=True)
class CourseMeasures:
    elapsed_s: float
    distance_m: float  # driven, forwards and in reverse
    laps: float
    interventions: int
    autonomy_percent: float  # 100 * (1 - 6 s * interventions / elapsed s), at least 0
    mean_offset: float  # of |offset| / half width, over time
    max_offset: float
    steering_per_s: float  # mean |d steering / dt| of the commands
    mean_speed_mph: float


class Course:
    """Drives the vehicle along a road in steps of 0.02 s. It starts at rest on the centre line, at arc length 0.

    Progress is the length of road that the car has covered ON the road: driving back reduces it, and a part that
    is skipped off the road does not count. The car is off the road if its centre is farther from the centre line
    than half the width of the road.
    """

    line: Centreline
    vehicle: CarState
    arc_m: float  # the car's place along the road, 0 .. length of the road
    offset_m: float  # of the car's centre from the centre line, positive to the left
    interventions: int
    progress_m: float  # along the road since the start (negative behind the start)

    def __init__(self, road: Track, height_m: Height | None = None) -> None:
        self.line = road.line
        self._half_width_m: list[float] = road.half_width_m.tolist()
        self._height_m = height_m
        self.start()

    def start(self, arc_m: float = 0.0) -> None:
        """Put the car at rest on the centre line at ``arc_m``, and reset the measures."""
        self._steps = 0
        self._pause_s = 0.0
        self._distance_m = 0.0
        self.progress_m = 0.0
        self._best_progress_m = 0.0
        self._offset_sum = 0.0
        self._max_offset = 0.0
        self._steering = 0.0
        self._steering_travel = 0.0
        self.interventions = 0
        self._put(arc_m, 0.0, 0.0, CarState(0.0, 0.0, 0.0))

    def advance(self, steering: float, throttle: float, seconds: float = STEP_S) -> None:
        """Hold a command (both values are clamped to -1..1) for ``seconds``, a whole number of 0.02 s steps."""
        steps = round(seconds / STEP_S)
        if steps < 1 or abs(steps * STEP_S - seconds) > 1e-6:
            raise ValueError(f"{seconds} s is not a whole number of {STEP_S} s steps")
        steering = min(1.0, max(-1.0, steering))
        self._steering_travel += abs(steering - self._steering)
        self._steering = steering
        for _ in range(steps):
            place = self.line.at(self.arc_m)
            slope = place.slope * math.cos(self.vehicle.heading_rad - place.heading_rad)
            self.vehicle = step(self.vehicle, steering, throttle, slope, self.off_road)
            self._measure()

    def intervene(self) -> None:
        """Put the car at rest on the centre line, aligned, where it last was on the road. Counts an
        intervention."""
        self.interventions += 1
        self._put(self._road_arc_m, 0.0, 0.0, CarState(0.0, 0.0, 0.0))

    def displace(self, offset_m: float, turn_rad: float, seconds: float) -> None:
        """Move the car to ``offset_m`` from the centre line at its arc length, turned by ``turn_rad`` (left is
        positive) from the road's direction. The car keeps its speed. Only the clock advances, by ``seconds``."""
        self._pause_s += seconds
        self._put(self.arc_m, offset_m, turn_rad, self.vehicle)

    @property
    def time_s(self) -> float:
        """The simulated time since the start, including the time of displacements."""
        return self._steps * STEP_S + self._pause_s

    @property
    def half_width_m(self) -> float:
        point: int = round(self.arc_m / self.line.step_m)
        return self._half_width_m[point % len(self._half_width_m)]

    @property
    def offset(self) -> float:
        """The car's distance from the centre line as a share of the half width, positive to the left."""
        return self.offset_m / self.half_width_m

    @property
    def off_road(self) -> bool:
        return abs(self.offset_m) > self.half_width_m

    @property
    def heading_error_rad(self) -> float:
        """The car's heading minus the road's, -pi..pi: positive if the car points to the left of the road."""
        error = self.vehicle.heading_rad - self.line.at(self.arc_m).heading_rad
        return math.remainder(error, math.tau)

    @property
    def laps(self) -> float:
        """The number of laps, including the part of the current lap."""
        return self.progress_m / self.line.length_m

    @property
    def whole_laps(self) -> int:
        """The number of finished laps. Crossing the line backwards and again does not count twice."""
        return int(self._best_progress_m / self.line.length_m)

    @property
    def stuck(self) -> bool:
        """True after ``STUCK_S`` without progress: the car stands, turns in circles or drives the wrong way."""
        return (self._steps - self._progress_step) * STEP_S >= STUCK_S

    @property
    def intervention_due(self) -> bool:
        """True if the car is off the road or stuck: the rule for interventions without a person's judgement."""
        return self.off_road or self.stuck

    @property
    def measures(self) -> CourseMeasures:
        elapsed = self._steps * STEP_S
        steps, seconds = max(1, self._steps), max(STEP_S, elapsed)
        return CourseMeasures(
            elapsed_s=elapsed,
            distance_m=self._distance_m,
            laps=self.laps,
            interventions=self.interventions,
            autonomy_percent=autonomy_percent(self.interventions, seconds),
            mean_offset=self._offset_sum / steps,
            max_offset=self._max_offset,
            steering_per_s=self._steering_travel / seconds,
            mean_speed_mph=self._distance_m / seconds / MPS_PER_MPH,
        )

    @property
    def pose(self) -> Pose:
        """The place of the rear axle, and the angles of a car with four wheels on the ground.

        Pitch and roll are the slopes between the axles and between the wheels, which smooths bumps smaller than
        the car.
        """
        car = self.vehicle
        cos, sin = math.cos(car.heading_rad), math.sin(car.heading_rad)

        def height(forward_m: float, left_m: float) -> float:
            x, y = car.x_m + forward_m * cos - left_m * sin, car.y_m + forward_m * sin + left_m * cos
            if self._height_m is not None:
                return self._height_m(x, y)
            return self.line.at(self.line.project(x, y, self.arc_m)[0]).z_m

        rear, front = height(-AXLE_TO_CENTRE_M, 0.0), height(AXLE_TO_CENTRE_M, 0.0)
        left, right = height(0.0, WHEEL_TRACK_M / 2), height(0.0, -WHEEL_TRACK_M / 2)
        return Pose(
            x_m=car.x_m - AXLE_TO_CENTRE_M * cos,
            y_m=car.y_m - AXLE_TO_CENTRE_M * sin,
            z_m=rear,
            heading_rad=car.heading_rad,
            pitch_rad=math.atan2(front - rear, WHEELBASE_M),
            roll_rad=math.atan2(left - right, WHEEL_TRACK_M),
        )

    def _put(self, arc_m: float, offset_m: float, turn_rad: float, motion: CarState) -> None:
        place = self.line.at(arc_m)
        self.vehicle = CarState(
            place.x_m - offset_m * math.sin(place.heading_rad),
            place.y_m + offset_m * math.cos(place.heading_rad),
            place.heading_rad + turn_rad,
            motion.speed_mps,
            motion.wheel_angle_rad,
            motion.yaw_rate_radps,
        )
        self.arc_m = arc_m % self.line.length_m
        self.offset_m = offset_m
        self._road_arc_m = self.arc_m
        self._progress_mark_m = self.progress_m
        self._progress_step = self._steps

    def _measure(self) -> None:
        self._steps += 1
        moved_m = abs(self.vehicle.speed_mps) * STEP_S
        self._distance_m += moved_m
        arc_before_m, on_road_before = self.arc_m, not self.off_road
        self.arc_m, self.offset_m = self.line.project(self.vehicle.x_m, self.vehicle.y_m, self.arc_m)
        offset = abs(self.offset)
        self._offset_sum += offset
        self._max_offset = max(self._max_offset, offset)
        if offset <= 1.0:
            # The shortest way around the loop. On the inside of a bend, the arc length grows faster than the car
            # moves, by up to the spacing of the points. A jump from one arm of a hairpin to the other does not
            # count.
            gained_m = math.remainder(self.arc_m - arc_before_m, self.line.length_m)
            if on_road_before and abs(gained_m) <= self.line.step_m + 4.0 * moved_m:
                self.progress_m += gained_m
            self._road_arc_m = self.arc_m
        self._best_progress_m = max(self._best_progress_m, self.progress_m)
        if self.progress_m >= self._progress_mark_m + _STUCK_PROGRESS_M:
            self._progress_mark_m, self._progress_step = self.progress_m, self._steps
