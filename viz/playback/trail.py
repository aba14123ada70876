"""A driven path, seen from above, in a bounded number of points."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

MAX_POINTS: Final = 2000  # of longer paths, every second one


class Trail:
    """The points of a path, as far apart as needed for it to have at most `MAX_POINTS`."""

    def __init__(self) -> None:
        self.points: list[tuple[float, float]] = []
        self._apart_m = 1.0

    def add(self, points: NDArray[np.float64]) -> None:
        """Points (N, 2) in m, in the order in which they were driven."""
        for x, y in points.tolist():
            if not self.points or math.dist(self.points[-1], (x, y)) >= self._apart_m:
                self.points.append((x, y))
            if len(self.points) > MAX_POINTS:
                self.points = self.points[::2]
                self._apart_m *= 2
