"""A driver like a person with a mouse: the button is pressed, the mouse dragged aside, the button let go.

Udacity's simulator steers by how far the mouse is from where its button went down, and straight ahead as soon as
the button is up. How far and how long it is dragged is fitted to a recording of one (docs/studies/drivers.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from simulator.driving.person import Act, Person

FULL_LOCK_PX: Final = 170
"""A sixth of a window of 1024: the recording's values are multiples of 25 / 170 degrees."""

# Between two drags the car goes straight, so that one has to steer more than is wanted, and as long as it takes.
_GAIN = 2.0
_GAIN_SPREAD = 0.15  # of its logarithm, as the other spreads
_HELD_S = 0.9
_HELD_SPREAD = 0.25
_HAND_S = 0.35  # the time constant of the hand's approach to where it wants to be
_NEW_GRIP_S = 0.1  # to take the mouse back


@dataclass(frozen=True)
class Drag(Act):
    """A mouse that is moved with its button held; its target may lie beyond full lock: so does the table."""

    def steering(self, time_s: float) -> float:
        """Steering in whole pixels, ever more slowly towards the target, up to full lock; 0 without the button."""
        if not self.is_held(time_s):
            return 0.0
        moved = self.target * (1.0 - math.exp((self.down_s - time_s) / _HAND_S))
        return max(-1.0, min(1.0, round(moved * FULL_LOCK_PX) / FULL_LOCK_PX))

    def is_over(self, time_s: float) -> bool:
        """Let go, and the mouse is taken back."""
        return time_s >= self.up_s + _NEW_GRIP_S


class MouseDriver(Person):
    """Drives a course by dragging a mouse."""

    look_ahead_s = (
        1.2  # it steers in larger pieces than keys do: with 0.9 it weaves, and leaves the road at 15 mph
    )
    dead_band = 0.15

    def _begin(self, down_s: float, wanted: float) -> Drag:
        target = self._about(_GAIN * wanted, _GAIN_SPREAD)
        return Drag(target, down_s, down_s + self._about(_HELD_S, _HELD_SPREAD))
