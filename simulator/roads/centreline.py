"""The centre line of a closed road: where a place on the road is, and where on the road a place is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SPACING_M = 0.5


@dataclass(frozen=True)
class Place:
    """A point of the centre line."""

    x_m: float
    y_m: float
    z_m: float
    heading_rad: float  # of the tangent, counter-clockwise from +x
    curvature_per_m: float  # positive where the road turns left
    slope: float  # rise over run along the road


class Centreline:
    """A closed curve, resampled every ~0.5 m, driven in the direction of its points.

    ``points_m`` is (N, 3) float64: x east, y north, z up, in metres, without repeating the first point.
    The arc length ``arc_m`` runs from 0 to ``length_m`` (in the ground plane) and wraps around.
    ``offset_m`` is the signed distance from the centre line in the ground plane, positive to the LEFT.
    """

    def __init__(self, points_m: Floats) -> None:
        closed = np.vstack([points_m, points_m[:1]]).astype(np.float64)
        steps = np.hypot(*np.diff(closed[:, :2], axis=0).T)
        if len(points_m) < 3 or not np.all(steps > 0):
            raise ValueError("a centre line needs at least three points, no two neighbours alike")
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

    def at(self, arc_m: float) -> Place:
        """The place ``arc_m`` metres along the road (any number: it wraps around)."""
        position = (arc_m % self.length_m) / self.step_m
        i = int(position) % len(self.points_m)
        j, t = (i + 1) % len(self.points_m), position - int(position)
        point = (1 - t) * self.points_m[i] + t * self.points_m[j]
        turn = (self.heading_rad[j] - self.heading_rad[i] + np.pi) % (2 * np.pi) - np.pi
        return Place(
            float(point[0]), float(point[1]), float(point[2]),
            float(self.heading_rad[i] + t * turn),
            float((1 - t) * self.curvature_per_m[i] + t * self.curvature_per_m[j]),
            float((1 - t) * self.slope[i] + t * self.slope[j]),
        )  # fmt: skip

    def clearance_m(self, neighbours_m: float) -> float:
        """The distance of the road from itself: the smallest one between places that are more than
        ``neighbours_m`` apart along it, to about a metre."""
        plan = self.points_m[::6, :2]
        arc = np.arange(len(plan)) * 6 * self.step_m
        apart = np.abs(arc[:, None] - arc[None])
        apart = np.minimum(apart, self.length_m - apart)
        distance = np.hypot(*(plan[:, None] - plan[None]).transpose(2, 0, 1))
        return float(distance[apart > neighbours_m].min())

    def project(self, x_m: float, y_m: float, near_arc_m: float | None = None) -> tuple[float, float]:
        """The nearest place of the road: (arc_m in 0..length_m, offset_m, positive to the left of it).

        ``near_arc_m`` limits the search to 30 m either side of that arc length, so that a car stays on its
        own stretch where the road passes close to itself.
        """
        count = len(self.points_m)
        if near_arc_m is None:
            candidates = np.arange(count)
        else:
            reach = round(30.0 / self.step_m)
            candidates = (int(near_arc_m / self.step_m) + np.arange(-reach, reach + 1)) % count
        delta = self.points_m[candidates, :2] - (x_m, y_m)
        i = int(candidates[np.argmin(np.einsum("ij,ij->i", delta, delta))])
        heading = self.heading_rad[i]
        dx, dy = x_m - self.points_m[i, 0], y_m - self.points_m[i, 1]
        along = dx * np.cos(heading) + dy * np.sin(heading)
        offset = -dx * np.sin(heading) + dy * np.cos(heading)
        return float((i * self.step_m + along) % self.length_m), float(offset)
