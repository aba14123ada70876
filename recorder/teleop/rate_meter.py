"""Rates over the last seconds: of frames, and of simulated time."""

from __future__ import annotations

from collections import deque
from typing import Final

OVER_S: Final = 2.0


class RateMeter:
    """Counts frames, and how fast a simulator's clock goes beside this computer's."""

    def __init__(self) -> None:
        self._frames: deque[tuple[float, float]] = deque()  # this computer's time, the simulator's

    def add(self, now_s: float, simulated_s: float) -> None:
        """A frame of the moment `simulated_s`, at `now_s` of a monotonic clock."""
        if self._frames and simulated_s < self._frames[-1][1]:  # another drive
            self._frames.clear()
        self._frames.append((now_s, simulated_s))
        while self._frames[0][0] < now_s - OVER_S:
            self._frames.popleft()

    @property
    def frames_per_s(self) -> float:
        passed_s = self._frames[-1][0] - self._frames[0][0] if self._frames else 0.0
        return (len(self._frames) - 1) / passed_s if passed_s else 0.0

    @property
    def pace(self) -> float:
        """Simulated seconds per second; 1 is real time."""
        if not self._frames:
            return 1.0
        (first_s, first_simulated_s), (last_s, last_simulated_s) = self._frames[0], self._frames[-1]
        return (last_simulated_s - first_simulated_s) / (last_s - first_s) if last_s > first_s else 1.0
