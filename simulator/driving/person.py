"""The common base of drivers like people, with keys or a mouse: they look now and then, and react late."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.roads.centreline import Centreline

REACTION_S = 0.2  # on average, from seeing to the finger
_REACTION_SPREAD = 0.25  # either way, as a share
_ATTENTION_S = 0.3  # mean time between two looks at where the car goes: exponential, and never more than
_LONGEST_INATTENTION_S = 0.75

_DEAD_BAND_SPREAD = 0.4  # of its logarithm: people are not always as patient
_HOLD_ON = 0.7  # of full lock: hands that still want this much let go later than planned

_NEW_DRIVE_S = 0.5  # a clock that jumps by more has left out moments, in which the hands may have done anything


@dataclass(frozen=True)
class Act(ABC):
    """Something that hands do from ``down_s`` to ``up_s``, and the steering that comes of it."""

    target: float  # the steering that they go for: below 0 to the left, above to the right
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
        """-1 (left) .. 1 (right)."""

    @abstractmethod
    def is_over(self, time_s: float) -> bool:
        """True if the next one can begin."""


class Person(ABC):
    """Sees the road and wants what the expert would do there; the hands make of it what they can.

    ``set_speed_mph`` and ``noise`` are the expert's: what is wanted wanders by ``noise`` before the hands answer.
    The throttle is the expert's too. The same seed and course give the same drive. Hands move at any moment: call
    `control` at each step of the simulator.
    """

    look_ahead_s: float
    """As the expert's, and farther: people react late."""
    dead_band: float
    """Of full lock: the median of what has to be wanted before anything is done."""

    def __init__(self, line: Centreline, set_speed_mph: float, noise: float = 0.0, seed: int = 0) -> None:
        self._wish = Expert(line, set_speed_mph, noise, seed, self.look_ahead_s)
        self._random = np.random.default_rng([seed, 1])  # beside the wish's, which is drawn from the seed alone
        self._time_s = -math.inf
        self._next_look_s = -math.inf
        self._act: Act | None = None  # the present one, or the last

    @property
    def act(self) -> Act | None:
        """What the hands do, or did last; None before the first act."""
        return self._act

    def wish(self, course: Course) -> tuple[float, float]:
        """The command that is wanted for the course's present state, whatever the hands make of it."""
        return self._wish.control(course)

    def control(self, course: Course) -> tuple[float, float]:
        """The command for the course's present state: steering -1 (left) .. 1 (right), throttle -1 .. 1."""
        wanted, throttle = self._wish.control(course)
        now_s = course.time_s
        if not 0.0 <= now_s - self._time_s <= _NEW_DRIVE_S:
            self._act = None  # the hands are off
            self._next_look_s = now_s
        self._time_s = now_s
        if now_s >= self._next_look_s:
            self._look(now_s, wanted)
        steering = self._act.steering(now_s) if self._act else 0.0
        return steering + 0.0, throttle  # a left key that is let go leaves no -0.0

    @abstractmethod
    def _begin(self, down_s: float, wanted: float) -> Act:
        """The act that begins at ``down_s`` towards the steering ``wanted``, -1 (left) .. 1 (right)."""

    def _look(self, now_s: float, wanted: float) -> None:
        """Look, if the hands are free or could let go: until then, it is tried again at each step."""
        if self._act is None or self._act.is_over(now_s):
            self._look_again(now_s)
            if abs(wanted) > self._about(self.dead_band, _DEAD_BAND_SPREAD):
                self._act = self._begin(now_s + self._reaction_s(), wanted)
        elif self._act.is_held(now_s):
            self._look_again(now_s)
            up_s = self._let_go_s(self._act.up_s, now_s, wanted * self._act.side)
            self._act = replace(self._act, up_s=up_s)

    def _look_again(self, after_s: float) -> None:
        self._next_look_s = after_s + min(_LONGEST_INATTENTION_S, self._random.exponential(_ATTENTION_S))

    def _reaction_s(self) -> float:
        return REACTION_S * self._random.uniform(1.0 - _REACTION_SPREAD, 1.0 + _REACTION_SPREAD)

    def _let_go_s(self, planned_s: float, now_s: float, still_wanted: float) -> float:
        """The time to let go, by the present view: sooner where the car has turned too far already (what is wanted
        is below 0: the other side), later where it has not turned enough."""
        soon_s = now_s + REACTION_S
        if still_wanted < 0.0:
            return min(planned_s, soon_s)
        return max(planned_s, soon_s) if still_wanted > _HOLD_ON else planned_s

    def _about(self, value: float, spread: float) -> float:
        """The value, off by so much: the standard deviation of its logarithm."""
        return value * math.exp(spread * self._random.standard_normal())
