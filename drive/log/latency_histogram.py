"""A histogram of latencies: percentiles over hours of driving, in fixed memory."""

from __future__ import annotations

import math
from array import array
from typing import Final

SMALLEST_MS: Final = 1e-3
LARGEST_MS: Final = 1e5
RESOLUTION: Final = 0.01
"""The largest relative error of a percentile."""

_RATIO: Final = math.log(1 + 2 * RESOLUTION)
_BINS: Final = math.ceil(math.log(LARGEST_MS / SMALLEST_MS) / _RATIO) + 1


class LatencyHistogram:
    """A histogram of times in ms with 930 bins from 1 us to 100 s, each 2 % wider than the one before.

    Times outside count in the first or the last bin; `max_ms` is exact.
    """

    def __init__(self) -> None:
        self.count = 0
        self.max_ms = 0.0
        self._bins = array("q", bytes(8 * _BINS))

    def add(self, ms: float) -> None:
        self.count += 1
        self.max_ms = max(self.max_ms, ms)
        self._bins[_bin(ms)] += 1

    def percentile_ms(self, percent: float) -> float:
        """The smallest time that at least `percent` % of all times do not exceed; 0 without times."""
        if not self.count:
            return 0.0
        rank = max(1, math.ceil(percent / 100 * self.count))
        cumulative = 0
        for number, times in enumerate(self._bins):
            cumulative += times
            if cumulative >= rank:
                return min(SMALLEST_MS * math.exp((number + 0.5) * _RATIO), self.max_ms)
        return self.max_ms

    def __str__(self) -> str:
        """Median, 99th percentile and maximum, as 1.90/2.71/9.02."""
        return "/".join(f"{ms:.2f}" for ms in (self.percentile_ms(50), self.percentile_ms(99), self.max_ms))


def _bin(ms: float) -> int:
    if not ms > SMALLEST_MS:
        return 0
    return int(math.log(min(ms, LARGEST_MS) / SMALLEST_MS) / _RATIO)
