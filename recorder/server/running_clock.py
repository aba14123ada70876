"""A clock that stands while this process does: by it, silence is judged."""

from __future__ import annotations

import time
from typing import Final

MAX_TICK_S: Final = 0.2
"""The most that one tick adds: twice the time between two ticks that come on time."""


class RunningClock:
    """Seconds for which this process ran, counted by its ticks.

    A tick comes late where the process was stopped, its machine slept, or others had the processor. Nothing was
    read meanwhile, so that nobody was silent: it adds no more than one that is almost on time.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._ticked_s = time.monotonic()

    def tick(self) -> float:
        """Advance; the clock's time."""
        now_s = time.monotonic()
        self.seconds += min(now_s - self._ticked_s, MAX_TICK_S)
        self._ticked_s = now_s
        return self.seconds
