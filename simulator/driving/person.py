"""The base class of drivers like people, with keys or a mouse: they look at intervals, and react with a delay."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.roads.centreline import Centreline

REACTION_S = 0.2  # mean time from seeing to moving a finger
_REACTION_SPREAD = 0.25  # share, in both directions
_ATTENTION_S = 0.3  # mean time between two looks at the road, exponentially distributed
_MAX_INATTENTION_S = 0.75  # maximum time between two looks

_DEAD_BAND_SPREAD = 0.4  # standard deviation of the logarithm: people are not equally patient at all times
_HOLD_ON = 0.7  # share of full lock: if the wanted steering is still more, the release is later than planned

_NEW_DRIVE_S = 0.5  # if the clock jumps by more, the hands start at rest


@dataclass(frozen=True)
class Act(ABC):
    """An action of the hands from ``down_s`` to ``up_s``, and its steering."""

    target: float  # the intended steering: below 0 to the left, above 0 to the right
    down_s: float
    up_s: float

    @property
    def side(self) -> float:
        """-1 (left) or 1 (right)."""
        return math.copysign(1.0, self.target)

    def is_held(self, time_s: float) -> bool:
        return self.down_s < time_s < self.up_s

    @abstractmethod
    def steering(self, time_s: float) -> float:
        """The steering at a time, -1 (left) .. 1 (right)."""

    @abstractmethod
    def is_over(self, time_s: float) -> bool:
        """True if the next act can begin."""


class Person(ABC):
    """Wants the steering of the expert, and approximates it with acts of the hands.

    ``set_speed_mph`` and ``noise`` are those of the expert: the noise is in the wanted steering. The throttle is
    the expert's. The same seed and course give the same drive. The hands may move at any moment: call `control` at
    every step of the simulator.
    """

    look_ahead_s: float
    """As for the expert, but larger, because people react late."""
    dead_band: float
    """The median wanted steering, as a share of full lock, from which the hands act."""

    def __init__(self, line: Centreline, set_speed_mph: float, noise: float = 0.0, seed: int = 0) -> None:
        self._wish = Expert(line, set_speed_mph, noise, seed, self.look_ahead_s)
        self._random = np.random.default_rng([seed, 1])  # independent of the expert's, whose seed is `seed`
        self._time_s = -math.inf
        self._next_look_s = -math.inf
        self.act: Act | None = None
        """The current or the last act of the hands; None before the first act."""

    def wish(self, course: Course) -> tuple[float, float]:
        """The wanted command for the course's current state, without the limits of the hands."""
        return self._wish.control(course)

    def control(self, course: Course) -> tuple[float, float]:
        """The command for the course's current state: steering -1 (left) .. 1 (right), throttle -1 .. 1."""
        wanted, throttle = self._wish.control(course)
        now_s = course.time_s
        if not 0.0 <= now_s - self._time_s <= _NEW_DRIVE_S:
            self.act = None  # the hands start at rest
            self._next_look_s = now_s
        self._time_s = now_s
        if now_s >= self._next_look_s:
            self._look(now_s, wanted)
        steering = self.act.steering(now_s) if self.act else 0.0
        return steering + 0.0, throttle  # + 0.0 converts the -0.0 of a released left key

    @abstractmethod
    def _begin(self, down_s: float, wanted: float) -> Act:
        """The act that begins at ``down_s`` towards the steering ``wanted``, -1 (left) .. 1 (right)."""

    def _look(self, now_s: float, wanted: float) -> None:
        """Look at the road if the hands are free or hold something; otherwise the next step tries again."""
        if self.act is None or self.act.is_over(now_s):
            self._look_again(now_s)
            if abs(wanted) > self._about(self.dead_band, _DEAD_BAND_SPREAD):
                self.act = self._begin(now_s + self._reaction_s(), wanted)
        elif self.act.is_held(now_s):
            self._look_again(now_s)
            up_s = self._let_go_s(self.act.up_s, now_s, wanted * self.act.side)
            self.act = replace(self.act, up_s=up_s)

    def _look_again(self, after_s: float) -> None:
        self._next_look_s = after_s + min(_MAX_INATTENTION_S, self._random.exponential(_ATTENTION_S))

    def _reaction_s(self) -> float:
        return REACTION_S * self._random.uniform(1.0 - _REACTION_SPREAD, 1.0 + _REACTION_SPREAD)

    def _let_go_s(self, planned_s: float, now_s: float, still_wanted: float) -> float:
        """The time to let go. It is earlier than planned if the car has turned too far: then the wanted steering
        is to the other side, below 0. It is later if the car has not turned enough."""
        soon_s = now_s + REACTION_S
        if still_wanted < 0.0:
            return min(planned_s, soon_s)
        return max(planned_s, soon_s) if still_wanted > _HOLD_ON else planned_s

    def _about(self, value: float, spread: float) -> float:
        """A random value around `value`; `spread` is the standard deviation of its logarithm."""
        return value * math.exp(spread * self._random.standard_normal())
