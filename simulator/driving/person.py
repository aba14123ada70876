"""What drivers like people have in common, whatever they steer by: they look now and then, and answer late."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.roads.centreline import Centreline

REACTION_S = 0.2  # on average, from seeing to the finger
_REACTION_SPREAD = 0.25  # either way, as a share
_ATTENTION_S = 0.3  # mean time between two looks at where the car goes: exponential, and never more than
_LONGEST_INATTENTION_S = 0.75

_HOLD_ON = 0.7  # of full lock: whoever still wants this much lets go later than planned

_NEW_DRIVE_S = 0.5  # a clock that jumps by more has left out moments: nobody knows what the hands did there


class Person(ABC):
    """Sees the road and wants what the expert would do there; the hands make of it what they can.

    ``set_speed_mph`` and ``noise`` are the expert's: what is wanted wanders by ``noise`` before the hands answer.
    The throttle is the expert's too. The same seed and course give the same drive. Hands move at any moment: call
    `control` at each step of the simulator.
    """

    look_ahead_s: float
    """As the expert's, and farther: who answers late has to."""

    def __init__(self, line: Centreline, set_speed_mph: float, noise: float = 0.0, seed: int = 0) -> None:
        self._wish = Expert(line, set_speed_mph, noise, seed, self.look_ahead_s)
        self._random = np.random.default_rng([seed, 1])  # beside the wish's, which is drawn from the seed alone
        self._time_s = -math.inf
        self._next_look_s = -math.inf

    def control(self, course: Course) -> tuple[float, float]:
        """The command for the course's present state: steering -1 (left) .. 1 (right), throttle -1 .. 1."""
        wanted, throttle = self._wish.control(course)
        now_s = course.time_s
        if not 0.0 <= now_s - self._time_s <= _NEW_DRIVE_S:
            self._rest()
            self._next_look_s = now_s
        self._time_s = now_s
        if now_s >= self._next_look_s:
            self._look(now_s, wanted)
        return self._steering(now_s), throttle

    @abstractmethod
    def _rest(self) -> None:
        """Take the hands off: steering is 0."""

    @abstractmethod
    def _look(self, now_s: float, wanted: float) -> None:
        """Called at each step until it tells, by `_look_again`, that it has looked."""

    @abstractmethod
    def _steering(self, now_s: float) -> float:
        """-1 (left) .. 1 (right)."""

    def _look_again(self, after_s: float) -> None:
        self._next_look_s = after_s + min(_LONGEST_INATTENTION_S, self._random.exponential(_ATTENTION_S))

    def _reaction_s(self) -> float:
        return REACTION_S * self._random.uniform(1.0 - _REACTION_SPREAD, 1.0 + _REACTION_SPREAD)

    def _let_go_s(self, planned_s: float, now_s: float, still_wanted: float) -> float:
        """When to let go, as it looks now: sooner where the car has turned too far already (what is wanted is
        below 0: the other side), later where it has not turned enough."""
        soon_s = now_s + REACTION_S
        if still_wanted < 0.0:
            return min(planned_s, soon_s)
        return max(planned_s, soon_s) if still_wanted > _HOLD_ON else planned_s

    def _about(self, value: float, spread: float) -> float:
        """The value, off by so much: the standard deviation of its logarithm."""
        return value * math.exp(spread * self._random.standard_normal())
