"""Ray casting over a height map: the distance to the ground along each line of sight.

The map is sampled on a fan: columns at equal steps of the tangent of the azimuth, rows at distances in geometric
progression. In a column, a sample is visible if its elevation is larger than those of all nearer samples. So the
running maximum of the elevations gives the sample at which each line of sight ends.
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
BLOCKS = 15  # of rows; divides SAMPLES and ROWS
COARSE = 4  # far samples, which are far apart, are taken from a map with cells larger by this factor
COARSE_FROM_M = 45.0


@dataclass(frozen=True)
class Eye:
    """A viewpoint: its place in cells of the map, its height in metres, and the horizontal direction of view."""

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
        # Tables for cv2.LUT: 1 / distance of each sample, and the step to the next sample. Beyond the last sample
        # is the sky: 0.
        inverse = 1.0 / self._distance_m[:, 0]
        self._inverse, self._step = np.zeros((2, 1, 256), np.float32)
        self._numbers = np.arange(SAMPLES, dtype=np.uint8)[:, None].repeat(COLUMNS, axis=1)
        self._inverse[0, : SAMPLES - 1], self._step[0, : SAMPLES - 1] = inverse[:-1], np.diff(inverse)

    def inverse_distance(self, eye: Eye, side: tuple[float, float], up: tuple[float, float]) -> Field:
        """1 / distance ahead (1/m) to the ground, (ROWS, COLUMNS) float32; 0 for the sky.

        Column and row are the point at which the line of sight crosses a vertical plane one metre ahead. Columns
        are from ``side[0]`` to ``side[1]`` metres to the left, rows from ``up[0]`` to ``up[1]`` metres up.
        """
        levels = self._slopes(eye, np.linspace(*side, COLUMNS, dtype=np.float32)[None, :])
        levels -= np.float32(up[0])
        levels *= np.float32((ROWS - 1) / (up[1] - up[0]))
        # The last sample below each line of sight: write the number of each sample to the first row above the
        # sample, then take the running maximum over the rows. This is faster than a search for each line of sight.
        places = np.floor(levels)
        places += np.float32(1.0)
        np.clip(places, 0.0, ROWS, out=places)
        places *= np.float32(COLUMNS)
        places += np.arange(COLUMNS, dtype=np.float32)
        last = np.zeros((ROWS + 1) * COLUMNS, np.uint8)
        last[places.astype(np.intp)] = self._numbers
        last = last.reshape(-1, COLUMNS)[:ROWS]
        _carry_maximum(last)
        last = last[: np.count_nonzero(last.min(axis=1) < SAMPLES - 1)]  # all rows above show only sky
        # Between two samples the ground is a plane, on which 1 / distance is linear in the row.
        rise = np.ones_like(levels)
        np.clip(levels[1:] - levels[:-1], 1e-6, np.inf, out=rise[:-1])
        at = last * np.intp(COLUMNS)
        at += np.arange(COLUMNS)
        share = np.arange(len(last), dtype=np.float32)[:, None] - levels.take(at)
        share /= rise.take(at)
        np.clip(share, 0.0, 1.0, out=share)
        share *= cv2.LUT(last, self._step)
        inverse = np.zeros((ROWS, COLUMNS), np.float32)
        np.add(share, cv2.LUT(last, self._inverse), out=inverse[: len(last)])
        return inverse

    def _slopes(self, eye: Eye, side: Field) -> Field:
        """The tangent of the largest elevation up to each sample, (SAMPLES, COLUMNS)."""
        reach = self._distance_m / np.float32(CELL_M)
        column = np.float32(eye.column) + reach * (np.float32(eye.cos) - side * np.float32(eye.sin))
        row = np.float32(eye.row) + reach * (np.float32(eye.sin) + side * np.float32(eye.cos))
        height = np.empty((SAMPLES, COLUMNS), np.float32)
        k = self._split
        height[:k] = look_up(self._fine, column[:k], row[:k])
        centre = np.float32((COARSE - 1) / 2)  # of the first large cell, in small cells
        height[k:] = look_up(self._coarse, (column[k:] - centre) / COARSE, (row[k:] - centre) / COARSE)
        slopes = (height - np.float32(eye.height_m)) / self._distance_m
        _carry_maximum(slopes)
        return slopes


def _carry_maximum(rows: NDArray[Any]) -> None:
    """The same as np.maximum.accumulate over the rows, in place and in a third of the time: first within blocks,
    then from block to block."""
    blocks = rows.reshape(BLOCKS, -1, rows.shape[1])
    for k in range(1, blocks.shape[1]):
        np.maximum(blocks[:, k - 1], blocks[:, k], out=blocks[:, k])
    for k in range(1, BLOCKS):
        np.maximum(blocks[k - 1, -1], blocks[k], out=blocks[k])


def with_rim(image: NDArray[Any]) -> NDArray[Any]:
    """The image with its last row and column repeated, so that OpenCV can look up all places `on_map` without its
    slow handling of borders."""
    return np.asarray(cv2.copyMakeBorder(image, 0, 1, 0, 1, cv2.BORDER_REPLICATE))


def on_map(image: NDArray[Any], column: Field, row: Field) -> tuple[Field, Field]:
    """Clip coordinates to an image `with_rim`."""
    rows, columns = image.shape[:2]
    return np.clip(column, 0, columns - 2), np.clip(row, 0, rows - 2)


def look_up(image: NDArray[Any], column: Field, row: Field) -> NDArray[Any]:
    """Interpolate an image `with_rim` bilinearly; beyond the rim, the values of the rim."""
    return np.asarray(cv2.remap(image, *on_map(image, column, row), cv2.INTER_LINEAR))
