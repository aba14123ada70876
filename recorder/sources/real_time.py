"""Real time for a simulated clock: a step begins when it is due, and later where the computer cannot follow."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Final

MAX_CATCH_UP_S: Final = 0.1
"""A clock that is later than that does not catch up: the drive was in slow motion."""
_PACE_S: Final = 2.0  # the pace is that of so much simulated time


class RealTime:
    """Paces the steps of a simulated clock, each `step_s` long."""

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self._due_s = time.monotonic()
        self._steps: deque[float] = deque(maxlen=round(_PACE_S / step_s) + 1)

    def wait(self, sooner: threading.Event | None = None) -> None:
        """Wait until the next step is due. `sooner` begins it before its time, by the length of a step at most."""
        self._due_s += self._step_s
        late_s = time.monotonic() - self._due_s
        if late_s < 0:
            time.sleep(max(0.0, -late_s - self._step_s))  # the step before was sooner
            if sooner is None or not sooner.wait(max(0.0, self._due_s - time.monotonic())):
                time.sleep(max(0.0, self._due_s - time.monotonic()))
        elif late_s > MAX_CATCH_UP_S:
            self._due_s += late_s
        self._steps.append(time.monotonic())

    @property
    def pace(self) -> float:
        """Simulated seconds in a real one, lately: 1 is real time."""
        if len(self._steps) < 2:
            return 1.0
        passed_s = self._steps[-1] - self._steps[0]
        return min(1.0, (len(self._steps) - 1) * self._step_s / passed_s) if passed_s > 0 else 1.0
