"""A driver like a person at a keyboard: late, in presses of a key, and only when the car strays enough.

It wants what the expert wants, and can only hold the left key, the right one, or none. What a held key does to
the steering is Unity's rule; when a key is pressed and for how long is fitted to recordings of people
(docs/drivers.md). That people steer in separate acts, each decided when an error has grown and then run off as
planned, is known of real cars too: Markkula, Boer, Romano and Merat 2018, "Sustained sensorimotor control as
intermittent decisions about prediction errors", Biological Cybernetics 112.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from simulator.driving.course import Course
from simulator.driving.expert import Expert
from simulator.roads.centreline import Centreline

# Sensitivity and gravity of its axis KeyboardHorizontal: ProjectSettings/InputManager.asset of Udacity's simulator
# (github.com/udacity/self-driving-car-sim). "0 4 13 22 25 25 16 9 0" degrees at 9 rows a second is what it gives.
AXIS_PER_S = 3.0  # of full lock, while a key is held; and back, when none is

# It looks farther ahead than the expert (0.6 s), as who answers late must: with 0.6 s, and with 1.2, it leaves the
# road more often at 15 and 20 mph.
_LOOK_AHEAD_S = 0.9
REACTION_S = 0.2  # on average, from seeing to the key
_REACTION_SPREAD = 0.25  # either way, as a share
_ATTENTION_S = 0.3  # mean time between two looks at where the car goes: exponential, and never more than
_LONGEST_INATTENTION_S = 0.75

DEAD_BAND = 0.12  # of full lock: the median of what has to be wanted before a key is pressed
_DEAD_BAND_SPREAD = 0.4  # of its logarithm: people are not always as patient

# A press is to do the work that the wanted steering would have done in this time, longer for more. Its length is
# off by so much (standard deviation of the logarithm), and no finger is faster than the shortest tap.
_PLANNED_S = 0.3
_PLANNED_MORE = 2.0  # times the wanted steering
_LENGTH_SPREAD = 0.4
_SHORTEST_TAP_S = 0.07
_HOLD_ON = 0.7  # of full lock: whoever still wants this much lets go later than planned

_NEW_DRIVE_S = 0.5  # a clock that jumps by more has left out moments: nobody knows what the hands did there


@dataclass(frozen=True)
class KeyPress:
    """A key that is held from ``down_s`` to ``up_s``, and the steering that comes of it."""

    side: float  # -1 the left key, 1 the right one
    down_s: float
    up_s: float

    def steering(self, time_s: float) -> float:
        """Unity's axis: it ramps to full lock while the key is held, and back when it is let go."""
        held = max(0.0, min(time_s, self.up_s) - self.down_s)
        back = max(0.0, time_s - self.up_s)
        return self.side * max(0.0, min(1.0, AXIS_PER_S * held) - AXIS_PER_S * back)

    def is_held(self, time_s: float) -> bool:
        return self.down_s < time_s < self.up_s

    def is_over(self, time_s: float) -> bool:
        """Let go, and the wheels are straight again."""
        return time_s >= self.up_s and self.steering(time_s) == 0.0


_NO_PRESS = KeyPress(1.0, -math.inf, -math.inf)


class KeyboardDriver:
    """Drives a course by the left and the right key; its throttle is the expert's.

    ``set_speed_mph`` and ``noise`` are the expert's: what is wanted wanders by ``noise`` before a key answers it.
    The same seed and course give the same drive. Keys go up and down at any moment: call `control` at each step.
    """

    def __init__(self, line: Centreline, set_speed_mph: float, noise: float = 0.0, seed: int = 0) -> None:
        self._wish = Expert(line, set_speed_mph, noise, seed, _LOOK_AHEAD_S)
        self._random = np.random.default_rng([seed, 1])  # beside the wish's, which is drawn from the seed alone
        self._time_s = -math.inf
        self._look_s = -math.inf  # when it looks next
        self._press = _NO_PRESS

    def control(self, course: Course) -> tuple[float, float]:
        """The command for the course's present state: steering -1 (left) .. 1 (right), throttle -1 .. 1."""
        wanted, throttle = self._wish.control(course)
        now_s = course.time_s
        if not 0.0 <= now_s - self._time_s <= _NEW_DRIVE_S:
            self._press, self._look_s = _NO_PRESS, now_s
        self._time_s = now_s
        if now_s >= self._look_s:
            if self._press.is_over(now_s):
                self._decide(now_s, wanted)
            elif self._press.is_held(now_s):
                self._watch(now_s, wanted)
        return self._press.steering(now_s), throttle

    def _decide(self, now_s: float, wanted: float) -> None:
        self._look_again(now_s)
        if abs(wanted) <= DEAD_BAND * math.exp(_DEAD_BAND_SPREAD * self._random.standard_normal()):
            return
        down_s = now_s + REACTION_S * self._random.uniform(1.0 - _REACTION_SPREAD, 1.0 + _REACTION_SPREAD)
        held_s = max(_SHORTEST_TAP_S, _press_length_s(abs(wanted)))
        held_s *= math.exp(_LENGTH_SPREAD * self._random.standard_normal())
        self._press = KeyPress(math.copysign(1.0, wanted), down_s, down_s + held_s)

    def _watch(self, now_s: float, wanted: float) -> None:
        """Let go sooner where the car has turned too far already, later where it has not turned enough."""
        self._look_again(now_s)
        soon_s = now_s + REACTION_S
        if wanted * self._press.side < 0.0:
            self._press = replace(self._press, up_s=min(self._press.up_s, soon_s))
        elif wanted * self._press.side > _HOLD_ON:
            self._press = replace(self._press, up_s=max(self._press.up_s, soon_s))

    def _look_again(self, now_s: float) -> None:
        self._look_s = now_s + min(_LONGEST_INATTENTION_S, self._random.exponential(_ATTENTION_S))


def _press_length_s(wanted: float) -> float:
    """How long a key is held so that the steering, summed over the ramps, is ``wanted`` over the planned time."""
    area = wanted * _PLANNED_S * (1.0 + _PLANNED_MORE * wanted)
    # Up and down without full lock: two triangles of AXIS_PER_S * held² together. With full lock: held itself.
    return math.sqrt(area / AXIS_PER_S) if area < 1.0 / AXIS_PER_S else area
