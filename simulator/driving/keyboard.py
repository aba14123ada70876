"""A driver like a person at a keyboard, who steers late, with key presses, and only after a sufficient error.

The driver wants the steering of the expert, but can only hold the left key, the right key, or none. The steering
follows a held key as in Unity. Times and lengths of the presses are fitted to recordings of people
(docs/studies/drivers.md). In real cars, too, people steer in separate acts. Each is decided after an error has
grown, and then executed as planned (Markkula, Boer, Romano and Merat 2018, "Sustained sensorimotor control as
intermittent decisions about prediction errors", Biological Cybernetics 112).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from simulator.driving.person import Act, Person

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
