"""Ray casting over a height map: the distance to the ground along each line of sight.

The map is sampled on a fan: columns at equal steps of the tangent of the azimuth, rows at distances in
geometric progression. Along a column a sample is seen if it stands at a steeper angle than everything before
it, so the running maximum of the angles gives the sample at which each line of sight ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simulator.rendering.noise import Field
from simulator.rendering.terrain import CELL_M

NEAR_M, FAR_M = 1.0, 340.0
COLUMNS, SAMPLES, ROWS = 400, 180, 240
COARSE = 4  # far samples are taken from a map of cells this much larger, as they are so far apart
COARSE_FROM_M = 45.0


@dataclass(frozen=True)
class Eye:
    """A viewpoint: its place in cells of the map, its height in metres, and the level direction it looks in."""

    column: float
    row: float
    height_m: float
    cos: float
    sin: float


class RayCaster:
    """Casts rays over one height map, (rows, columns) float32 in metres."""

    def __init__(self, height_m: Field) -> None:
        self._fine = with_rim(height_m)
        coarse = cv2.resize(height_m, None, fx=1 / COARSE, fy=1 / COARSE, interpolation=cv2.INTER_AREA)
        self._coarse = with_rim(coarse)
        self._distance_m = np.geomspace(NEAR_M, FAR_M, SAMPLES).astype(np.float32)[:, None]
        self._split = int(np.searchsorted(self._distance_m[:, 0], COARSE_FROM_M))
        # One over the distance to each sample, and the step to the next, as cv2.LUT reads them. Behind the last
        # sample is the sky: 0.
        inverse = 1.0 / self._distance_m[:, 0]
        self._inverse, self._step = np.zeros((2, 1, 256), np.float32)
        self._inverse[0, : SAMPLES - 1], self._step[0, : SAMPLES - 1] = inverse[:-1], np.diff(inverse)

    def inverse_distance(self, eye: Eye, side: tuple[float, float], up: tuple[float, float]) -> Field:
        """One over the forward distance (1/m) to the ground, (ROWS, COLUMNS) float32, 0 for the sky.

        Column and row give the point where the line of sight pierces a vertical plane one metre ahead: columns run
        from ``side[0]`` to ``side[1]`` metres to the left, rows from ``up[0]`` to ``up[1]`` metres up.
        """
        slopes = self._slopes(eye, np.linspace(*side, COLUMNS, dtype=np.float32)[None, :])
        # The number of samples below each line of sight is the number of the sample that ends it: count them
        # all at once in a histogram over the rows. Cheaper than a search per line of sight.
        levels = (slopes - np.float32(up[0])) * np.float32((ROWS - 1) / (up[1] - up[0]))
        first_above = np.clip(np.floor(levels) + np.float32(1.0), 0, ROWS) * np.float32(COLUMNS)
        lanes = np.arange(COLUMNS)
        bins = (first_above + lanes.astype(np.float32)).astype(np.intp)
        counts = np.bincount(bins.ravel(), minlength=COLUMNS * ROWS)[: COLUMNS * ROWS].reshape(ROWS, COLUMNS)
        sums = cv2.integral(
            counts.astype(np.uint8)
        )  # over rows and columns: ten times as fast as np.cumsum over rows
        below = sums[1:, 1:] - sums[1:, :-1]
        ground = below[: np.count_nonzero(below.min(axis=1) < SAMPLES)]
        last = (np.maximum(ground, 1) - 1).astype(np.uint8)
        # Between two samples the ground is a plane, on which one over the distance is linear in the row.
        rise = np.ones_like(levels)
        np.maximum(levels[1:] - levels[:-1], np.float32(1e-6), out=rise[:-1])
        at = last * np.intp(COLUMNS) + lanes
        share = (np.arange(len(ground), dtype=np.float32)[:, None] - levels.take(at)) / rise.take(at)
        inverse = np.zeros((ROWS, COLUMNS), np.float32)
        inverse[: len(ground)] = cv2.LUT(last, self._inverse) + np.clip(share, 0.0, 1.0) * cv2.LUT(
            last, self._step
        )
        return inverse

    def _slopes(self, eye: Eye, side: Field) -> Field:
        """The tangent of the steepest elevation up to each sample, (SAMPLES, COLUMNS)."""
        reach = self._distance_m / np.float32(CELL_M)
        column = np.float32(eye.column) + reach * (np.float32(eye.cos) - side * np.float32(eye.sin))
        row = np.float32(eye.row) + reach * (np.float32(eye.sin) + side * np.float32(eye.cos))
        height = np.empty((SAMPLES, COLUMNS), np.float32)
        k = self._split
        height[:k] = look_up(self._fine, column[:k], row[:k])
        centre = np.float32((COARSE - 1) / 2)  # of the first large cell, in small ones
        height[k:] = look_up(self._coarse, (column[k:] - centre) / COARSE, (row[k:] - centre) / COARSE)
        slopes = (height - np.float32(eye.height_m)) / self._distance_m
        for k in range(1, SAMPLES):  # as np.maximum.accumulate, in half of its time
            np.maximum(slopes[k - 1], slopes[k], out=slopes[k])
        return slopes


def with_rim(image: NDArray[Any]) -> NDArray[Any]:
    """The image with its last row and column twice, so that OpenCV finds all that is `on_map` without its slow
    borders."""
    return np.asarray(cv2.copyMakeBorder(image, 0, 1, 0, 1, cv2.BORDER_REPLICATE))


def on_map(image: NDArray[Any], column: Field, row: Field) -> tuple[Field, Field]:
    """The nearest places on an image `with_rim`."""
    rows, columns = image.shape[:2]
    return np.clip(column, 0, columns - 2), np.clip(row, 0, rows - 2)


def look_up(image: NDArray[Any], column: Field, row: Field) -> NDArray[Any]:
    """Bilinear values of an image `with_rim`; beyond its rim those of the rim."""
    return np.asarray(cv2.remap(image, *on_map(image, column, row), cv2.INTER_LINEAR))
