"""Hands that wander slowly and without jerks: an Ornstein-Uhlenbeck process, passed once through a lag."""

from __future__ import annotations

import math

import numpy as np

TIME_S = 1.0
LAG_S = 0.2


class Wandering:
    """Smooth noise over time with a given standard deviation; the same seed gives the same."""

    def __init__(self, deviation: float, seed: int) -> None:
        # The lag takes some of the process's variance away; this much is put in to leave ``deviation``.
        self._deviation = deviation * math.sqrt(1.0 + LAG_S / TIME_S)
        self._random = np.random.default_rng(seed)
        self._time_s = 0.0
        self._raw = 0.0
        self._smooth = 0.0

    def at(self, time_s: float) -> float:
        if self._deviation == 0.0:
            return 0.0
        # A time that starts again is a new drive.
        passed_s = max(0.0, time_s - self._time_s)
        self._time_s = time_s
        keep = math.exp(-passed_s / TIME_S)
        spread = self._deviation * math.sqrt(1.0 - keep * keep)
        self._raw = keep * self._raw + spread * self._random.standard_normal()
        self._smooth += (self._raw - self._smooth) * (1.0 - math.exp(-passed_s / LAG_S))
        return self._smooth
