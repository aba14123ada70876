"""Real time for a simulated clock: a step begins when it is due, or later if the computer is too slow."""

from __future__ import annotations

import threading
import time
from typing import Final

from recorder.teleop.rate_meter import RateMeter

MAX_CATCH_UP_S: Final = 0.1  # a later clock does not catch up: the drive was in slow motion


class RealTime:
    """Paces the steps of a simulated clock, each `step_s` long."""

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self._due_s = time.monotonic()
        self._steps = 0
        self._rates = RateMeter()

    def wait(self, sooner: threading.Event) -> None:
        """Wait until the next step is due. `sooner` begins it early, by at most a step's length."""
        self._due_s += self._step_s
        late_s = time.monotonic() - self._due_s
        if late_s < 0:
            time.sleep(max(0.0, -late_s - self._step_s))  # the previous step was early
            if not sooner.wait(max(0.0, self._due_s - time.monotonic())):
                time.sleep(max(0.0, self._due_s - time.monotonic()))
        elif late_s > MAX_CATCH_UP_S:
            self._due_s += late_s
        self._steps += 1
        self._rates.add(time.monotonic(), self._steps * self._step_s)

    @property
    def pace(self) -> float:
        """Simulated seconds per second, recently; 1 is real time."""
        pace = self._rates.pace
        return 1.0 if pace is None else min(1.0, pace)
