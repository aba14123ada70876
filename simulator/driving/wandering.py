"""Slow, smooth noise, like wandering hands: an Ornstein-Uhlenbeck process through a first-order lag."""

from __future__ import annotations

import math

import numpy as np

TIME_S = 1.0
LAG_S = 0.2


class Wandering:
    """Smooth noise over time with the standard deviation `deviation`; the same seed gives the same noise."""

    def __init__(self, deviation: float, seed: int) -> None:
        # The lag reduces the variance of the process. This factor restores the standard deviation.
        self._deviation = deviation * math.sqrt(1.0 + LAG_S / TIME_S)
        self._random = np.random.default_rng(seed)
        self._time_s = 0.0
        self._raw = 0.0
        self._smooth = 0.0

    def at(self, time_s: float) -> float:
        """The noise at a time, which must not be before that of the last call, except at the start of a drive."""
        if self._deviation == 0.0:
            return 0.0
        # If the time goes back, a new drive begins.
        passed_s = max(0.0, time_s - self._time_s)
        self._time_s = time_s
        keep = math.exp(-passed_s / TIME_S)
        spread = self._deviation * math.sqrt(1.0 - keep * keep)
        self._raw = keep * self._raw + spread * self._random.standard_normal()
        self._smooth += (self._raw - self._smooth) * (1.0 - math.exp(-passed_s / LAG_S))
        return self._smooth
