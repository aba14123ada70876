"""Ray casting over a height map: the distance to the ground along each line of sight.

The map is sampled on a fan: columns at equal steps of the tangent of the azimuth, rows at distances in
geometric progression. Along a column a sample is seen if it stands at a steeper angle than everything before
it, so the running maximum of the angles gives the sample at which each line of sight ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

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
        self._fine = height_m
        coarse = cv2.resize(height_m, None, fx=1 / COARSE, fy=1 / COARSE, interpolation=cv2.INTER_AREA)
        self._coarse: Field = np.asarray(coarse, dtype=np.float32)
        self._distance_m = np.geomspace(NEAR_M, FAR_M, SAMPLES).astype(np.float32)[:, None]
        self._inverse = np.append(1.0 / self._distance_m[:, 0], np.float32(0.0)).astype(np.float32)
        self._split = int(np.searchsorted(self._distance_m[:, 0], COARSE_FROM_M))
        self._lanes = (np.arange(COLUMNS) * (ROWS + 1))[None, :]

    def inverse_distance(self, eye: Eye, side: tuple[float, float], up: tuple[float, float]) -> Field:
        """One over the forward distance (1/m) to the ground, (ROWS, COLUMNS) float32, 0 for the sky.

        Column and row give the point where the line of sight pierces a vertical plane one metre ahead: columns run
        from ``side[0]`` to ``side[1]`` metres to the left, rows from ``up[0]`` to ``up[1]`` metres up.
        """
        slopes = self._slopes(eye, np.linspace(*side, COLUMNS, dtype=np.float32)[None, :])
        # The number of samples below each line of sight is the number of the sample that ends it: count them
        # all at once in a histogram over the rows. Cheaper than a search per line of sight.
        scale = np.float32((ROWS - 1) / (up[1] - up[0]))
        levels = (slopes - np.float32(up[0])) * scale
        first_above = np.clip(np.floor(levels) + 1.0, 0, ROWS).astype(np.intp) + self._lanes
        below = np.bincount(first_above.ravel(), minlength=COLUMNS * (ROWS + 1)).reshape(COLUMNS, ROWS + 1)
        end = np.maximum(np.cumsum(below[:, :ROWS], axis=1, dtype=np.int32).T, 1)
        sky = end >= SAMPLES
        np.minimum(end, SAMPLES - 1, out=end)
        # Between two samples the ground is a plane, on which one over the distance is linear in the row.
        flat = np.asarray(end * np.int32(COLUMNS) + np.arange(COLUMNS, dtype=np.int32), dtype=np.int32)
        low, high = levels.take(flat - COLUMNS), levels.take(flat)
        share = (np.arange(ROWS, dtype=np.float32)[:, None] - low) / np.maximum(high - low, np.float32(1e-6))
        near, far = self._inverse.take(end - 1), self._inverse.take(end)
        inverse = near + np.clip(share, 0.0, 1.0) * (far - near)
        inverse[sky] = 0.0
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
        return np.asarray(np.maximum.accumulate(slopes, axis=0), dtype=np.float32)


def look_up(image: Field, column: Field, row: Field) -> Field:
    """Bilinear values of an image; beyond its rim those of the rim."""
    values = cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, dtype=np.float32)
