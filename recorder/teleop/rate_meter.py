"""Rates over the last seconds: of frames, and of simulated time."""

from __future__ import annotations

from collections import deque
from typing import Final

OVER_S: Final = 2.0


class RateMeter:
    """Measures frames a second and the pace of a simulator's clock."""

    def __init__(self) -> None:
        self._frames: deque[tuple[float, float | None]] = deque()  # this computer's time, the simulator's

    def add(self, now_s: float, simulated_s: float | None = None) -> None:
        """Note a frame at `now_s` of a monotonic clock, and at `simulated_s`, if the simulator sends its time."""
        before_s = self._frames[-1][1] if self._frames else None
        if before_s is not None and simulated_s is not None and simulated_s < before_s:  # another drive
            self._frames.clear()
        self._frames.append((now_s, simulated_s))
        while self._frames[0][0] < now_s - OVER_S:
            self._frames.popleft()

    @property
    def frames_per_s(self) -> float:
        passed_s = self._frames[-1][0] - self._frames[0][0] if self._frames else 0.0
        return (len(self._frames) - 1) / passed_s if passed_s else 0.0

    @property
    def pace(self) -> float | None:
        """Simulated seconds per second; 1 is real time. None if unknown."""
        if not self._frames:
            return None
        (first_s, first_simulated_s), (last_s, last_simulated_s) = self._frames[0], self._frames[-1]
        if first_simulated_s is None or last_simulated_s is None or last_s <= first_s:
            return None
        return (last_simulated_s - first_simulated_s) / (last_s - first_s) or None  # a standing clock has no pace
