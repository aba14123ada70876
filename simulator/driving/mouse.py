"""A driver like a person with a mouse, who presses the button, drags the mouse to a side, and releases the button.

In Udacity's simulator, the steering is the distance from the place where the button was pressed; when the button
is released, it is 0. Distance and duration of the drags are fitted to a recording of a person
(docs/studies/drivers.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from simulator.driving.person import Act, Person

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
    look_ahead_s = 1.2  # drags are longer than key presses: with 0.9 the car weaves, and leaves the road at 15 mph
    dead_band = 0.15

    def _begin(self, down_s: float, wanted: float) -> Drag:
        target = self._about(_GAIN * wanted, _GAIN_SPREAD)
        return Drag(target, down_s, down_s + self._about(_HELD_S, _HELD_SPREAD))
