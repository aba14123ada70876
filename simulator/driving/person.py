"""Drivers like people: they look at intervals, react with a delay, and steer with keys or a mouse.

In real cars, too, people steer in separate acts. Each is decided after an error has grown, and then executed as
planned (Markkula, Boer, Romano and Merat 2018, "Sustained sensorimotor control as intermittent decisions about
prediction errors", Biological Cybernetics 112). Times and lengths are fitted to recordings of people
(docs/studies/drivers.md).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from simulator.driving.course import Course
from simulator.driving.drive_limits import DriverName
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

    look_ahead_s: float  # as for the expert, but larger, because people react late
    dead_band: float  # the median wanted steering, as a share of full lock, from which the hands act

    def __init__(self, line: Centreline, set_speed_mph: float, noise: float = 0.0, seed: int = 0) -> None:
        self.wish = Expert(line, set_speed_mph, noise, seed, self.look_ahead_s)
        self._random = np.random.default_rng([seed, 1])  # independent of the expert's, whose seed is `seed`
        self._time_s = -math.inf
        self._next_look_s = -math.inf
        self.act: Act | None = None  # the current or the last act of the hands; None before the first act

    def control(self, course: Course) -> tuple[float, float]:
        """The command for the course's current state: steering -1 (left) .. 1 (right), throttle -1 .. 1."""
        wanted, throttle = self.wish.control(course)
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


# Sensitivity and gravity of the axis KeyboardHorizontal: ProjectSettings/InputManager.asset of Udacity's simulator
# (github.com/udacity/self-driving-car-sim). At 9 rows a second, a press gives "0 4 13 22 25 25 16 9 0" degrees.
AXIS_PER_S = 3.0  # full locks per second, while a key is held; and back, after its release

# The steering of a press, summed over time, equals the wanted steering over the planned time. This time is longer
# for more steering. The length of the press is random around this value.
_PLANNED_S = 0.3
_PLANNED_MORE = 2.0  # times the wanted steering
_LENGTH_SPREAD = 0.4  # standard deviation of the logarithm
_MIN_TAP_S = 0.07


@dataclass(frozen=True)
class KeyPress(Act):
    """A press of a key: the left key with a target of -1, the right key with 1."""

    def steering(self, time_s: float) -> float:
        """The steering of Unity's axis: it rises to full lock while the key is held, and falls after its
        release."""
        held = max(0.0, min(time_s, self.up_s) - self.down_s)
        back = max(0.0, time_s - self.up_s)
        return self.side * max(0.0, min(1.0, AXIS_PER_S * held) - AXIS_PER_S * back)

    def is_over(self, time_s: float) -> bool:
        """True when the key is released and the steering is 0 again."""
        return time_s >= self.up_s and self.steering(time_s) == 0.0


class KeyboardDriver(Person):
    """Wants the steering of the expert, but can only hold the left key, the right key, or none."""

    look_ahead_s = 0.9  # with 0.6 (the expert's) and with 1.2, it leaves the road more often at 15 and 20 mph
    dead_band = 0.12

    def _begin(self, down_s: float, wanted: float) -> KeyPress:
        held_s = self._about(max(_MIN_TAP_S, _press_length_s(abs(wanted))), _LENGTH_SPREAD)
        return KeyPress(math.copysign(1.0, wanted), down_s, down_s + held_s)


def _press_length_s(wanted: float) -> float:
    """The time to hold a key, so that the steering summed over time equals ``wanted`` over the planned time."""
    area = wanted * _PLANNED_S * (1.0 + _PLANNED_MORE * wanted)
    # The area under the steering is AXIS_PER_S * held² without full lock (two triangles), and `held` with full
    # lock.
    return math.sqrt(area / AXIS_PER_S) if area < 1.0 / AXIS_PER_S else area


FULL_LOCK_PX: Final = 170
"""A sixth of a window of 1024 px: the values in the recording are multiples of 25 / 170 degrees."""

# The steering is 0 between two drags, so a drag has to steer more than the average steering.
_GAIN = 2.0
_GAIN_SPREAD = 0.15  # standard deviation of the logarithm, like the other spreads
_HELD_S = 0.9
_HELD_SPREAD = 0.25
_HAND_S = 0.35  # time constant of the hand's movement to its target
_NEW_GRIP_S = 0.1  # for moving the mouse back


@dataclass(frozen=True)
class Drag(Act):
    """A movement of the mouse with the button held. The target may be beyond full lock: the table is larger."""

    def steering(self, time_s: float) -> float:
        """The steering, in whole pixels: it approaches the target exponentially, up to full lock; 0 when the
        button is released."""
        if not self.is_held(time_s):
            return 0.0
        moved = self.target * (1.0 - math.exp((self.down_s - time_s) / _HAND_S))
        return max(-1.0, min(1.0, round(moved * FULL_LOCK_PX) / FULL_LOCK_PX))

    def is_over(self, time_s: float) -> bool:
        """True when the button is released and the mouse has been moved back."""
        return time_s >= self.up_s + _NEW_GRIP_S


class MouseDriver(Person):
    """Presses the button, drags the mouse to a side, and releases it. In Udacity's simulator, the steering is the
    distance from the place where the button was pressed; without the button, it is 0."""

    look_ahead_s = 1.2  # drags are longer than key presses: with 0.9 the car weaves, and leaves the road at 15 mph
    dead_band = 0.15

    def _begin(self, down_s: float, wanted: float) -> Drag:
        target = self._about(_GAIN * wanted, _GAIN_SPREAD)
        return Drag(target, down_s, down_s + self._about(_HELD_S, _HELD_SPREAD))


_DRIVERS: Final[dict[DriverName, type[Expert | KeyboardDriver | MouseDriver]]] = {
    "expert": Expert,
    "keyboard": KeyboardDriver,
    "mouse": MouseDriver,
}


def make_driver(
    name: DriverName, line: Centreline, set_speed_mph: float, noise: float, seed: int
) -> Expert | KeyboardDriver | MouseDriver:
    """A driver of the road ``line``. Raises ValueError for a speed of 0 or less, or a negative noise."""
    return _DRIVERS[name](line, set_speed_mph, noise, seed)
