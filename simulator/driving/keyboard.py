"""A driver like a person at a keyboard: late, in presses of a key, and only when the car strays enough.

It wants what the expert wants, and can only hold the left key, the right one, or none. What a held key does to
the steering is Unity's rule; when a key is pressed and for how long is fitted to recordings of people
(docs/studies/drivers.md). That people steer in separate acts, each decided when an error has grown and then run
off as planned, is known of real cars too: Markkula, Boer, Romano and Merat 2018, "Sustained sensorimotor control
as intermittent decisions about prediction errors", Biological Cybernetics 112.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from simulator.driving.person import Act, Person

# Sensitivity and gravity of its axis KeyboardHorizontal: ProjectSettings/InputManager.asset of Udacity's simulator
# (github.com/udacity/self-driving-car-sim). "0 4 13 22 25 25 16 9 0" degrees at 9 rows a second is what it gives.
AXIS_PER_S = 3.0  # of full lock, while a key is held; and back, when none is

# A press is to do the work that the wanted steering would have done in this time, longer for more. Its length is
# off by so much (standard deviation of the logarithm), and no finger is faster than the shortest tap.
_PLANNED_S = 0.3
_PLANNED_MORE = 2.0  # times the wanted steering
_LENGTH_SPREAD = 0.4
_SHORTEST_TAP_S = 0.07


@dataclass(frozen=True)
class KeyPress(Act):
    """A key that is held: the left one with a target of -1, the right one with 1."""

    def steering(self, time_s: float) -> float:
        """Unity's axis: it ramps to full lock while the key is held, and back when it is let go."""
        held = max(0.0, min(time_s, self.up_s) - self.down_s)
        back = max(0.0, time_s - self.up_s)
        return self.side * max(0.0, min(1.0, AXIS_PER_S * held) - AXIS_PER_S * back)

    def is_over(self, time_s: float) -> bool:
        """Let go, and the wheels are straight again."""
        return time_s >= self.up_s and self.steering(time_s) == 0.0


class KeyboardDriver(Person):
    """Drives a course by the left and the right key."""

    look_ahead_s = (
        0.9  # the expert has 0.6; with that, and with 1.2, it leaves the road more often at 15 and 20 mph
    )
    dead_band = 0.12

    def _begin(self, down_s: float, wanted: float) -> KeyPress:
        held_s = self._about(max(_SHORTEST_TAP_S, _press_length_s(abs(wanted))), _LENGTH_SPREAD)
        return KeyPress(math.copysign(1.0, wanted), down_s, down_s + held_s)


def _press_length_s(wanted: float) -> float:
    """The time to hold a key so that the steering, summed over the ramps, is ``wanted`` over the planned time."""
    area = wanted * _PLANNED_S * (1.0 + _PLANNED_MORE * wanted)
    # Up and down without full lock: two triangles of AXIS_PER_S * held² together. With full lock: held itself.
    return math.sqrt(area / AXIS_PER_S) if area < 1.0 / AXIS_PER_S else area
