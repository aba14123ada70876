"""The centre line of a closed road: positions from arc lengths, and arc lengths from positions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SPACING_M = 0.5
_NEAR_M = 30.0


class Place(NamedTuple):
    x_m: float
    y_m: float
    z_m: float
    heading_rad: float  # of the tangent, counter-clockwise from +x
    curvature_per_m: float  # positive if the road turns left
    slope: float  # rise over run along the road


class Centreline:
    """A closed curve, resampled every ~0.5 m. Cars drive in the direction of its points.

    ``points_m`` is (N, 3) float64: x east, y north, z up, in metres, without repeating the first point.
    The arc length ``arc_m`` runs from 0 to ``length_m`` (in the ground plane) and wraps around.
    ``offset_m`` is the signed distance from the centre line in the ground plane, positive to the LEFT.
    """

    def __init__(self, points_m: Floats) -> None:
        closed = np.vstack([points_m, points_m[:1]]).astype(np.float64)
        steps = np.hypot(*np.diff(closed[:, :2], axis=0).T)
        if len(points_m) < 3 or not np.all(steps > 0):
            raise ValueError("a centre line needs at least three points; neighbours must differ")
        arc = np.concatenate([[0.0], np.cumsum(steps)])
        count = max(8, round(arc[-1] / SPACING_M))
        grid = np.linspace(0.0, arc[-1], count, endpoint=False)
        self.points_m: Floats = np.stack([np.interp(grid, arc, closed[:, k]) for k in range(3)], axis=1)
        self.length_m = float(arc[-1])
        self.step_m = self.length_m / count
        ahead, behind = np.roll(self.points_m, -1, axis=0), np.roll(self.points_m, 1, axis=0)
        tangent = ahead - behind
        self.heading_rad: Floats = np.arctan2(tangent[:, 1], tangent[:, 0])
        turn = np.roll(self.heading_rad, -1) - np.roll(self.heading_rad, 1)
        self.curvature_per_m: Floats = ((turn + np.pi) % (2 * np.pi) - np.pi) / (2 * self.step_m)
        self.slope: Floats = tangent[:, 2] / (2 * self.step_m)
        # Lists, because `at` and `project` are called many times in a step, and elements of arrays are slower.
        columns = (*self.points_m.T, self.heading_rad, self.curvature_per_m, self.slope)
        self._points: list[tuple[float, ...]] = list(zip(*(column.tolist() for column in columns), strict=True))
        self._directions = [(float(np.cos(heading)), float(np.sin(heading))) for heading in self.heading_rad]
        self._reach = round(_NEAR_M / self.step_m)
        # (2, N + 2 reach + 1): the points, extended at both ends, so that the points near any place are a slice
        self._around_m = self.points_m[np.arange(-self._reach, count + self._reach + 1) % count, :2].T.copy()

    def at(self, arc_m: float) -> Place:
        """The place ``arc_m`` metres along the road (any number: it wraps around)."""
        position = (arc_m % self.length_m) / self.step_m
        i, t = int(position), position - int(position)
        count = len(self._points)
        x, y, z, heading, curvature, slope = self._points[i % count]
        next_x, next_y, next_z, next_heading, next_curvature, next_slope = self._points[(i + 1) % count]
        turn = (next_heading - heading + math.pi) % (2 * math.pi) - math.pi
        return Place(
            (1 - t) * x + t * next_x,
            (1 - t) * y + t * next_y,
            (1 - t) * z + t * next_z,
            heading + t * turn,
            (1 - t) * curvature + t * next_curvature,
            (1 - t) * slope + t * next_slope,
        )

    def clearance_m(self, neighbours_m: float) -> float:
        """The smallest distance between places of the road that are more than ``neighbours_m`` apart along the
        road, to about a metre."""
        plan = self.points_m[::6, :2]
        arc = np.arange(len(plan)) * 6 * self.step_m
        apart = np.abs(arc[:, None] - arc[None])
        apart = np.minimum(apart, self.length_m - apart)
        distance = np.hypot(*(plan[:, None] - plan[None]).transpose(2, 0, 1))
        return float(distance[apart > neighbours_m].min())

    def project(self, x_m: float, y_m: float, near_arc_m: float | None = None) -> tuple[float, float]:
        """The nearest place of the road: (arc_m in 0..length_m, offset_m, positive to the left).

        ``near_arc_m`` limits the search to 30 m before and after this arc length, so that a car stays on its own
        stretch if the road passes close to itself.
        """
        count = len(self._points)
        if near_arc_m is None:
            first, xs_m, ys_m = 0, self.points_m[:, 0], self.points_m[:, 1]
        else:
            middle = int(near_arc_m / self.step_m) % count
            first, (xs_m, ys_m) = middle - self._reach, self._around_m[:, middle : middle + 2 * self._reach + 1]
        dxs_m, dys_m = xs_m - x_m, ys_m - y_m
        i = (first + int((dxs_m * dxs_m + dys_m * dys_m).argmin())) % count
        cos, sin = self._directions[i]
        dx, dy = x_m - self._points[i][0], y_m - self._points[i][1]
        along = dx * cos + dy * sin
        return (i * self.step_m + along) % self.length_m, dy * cos - dx * sin
