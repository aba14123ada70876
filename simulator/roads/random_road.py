"""Random closed roads from a seed, for evaluation on roads that training has not used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.roads.built_in_tracks import LAKE, MOUNTAIN
from simulator.roads.centreline import Centreline, Floats
from simulator.roads.road_stretches import Look

LENGTHS_M = (650.0, 1150.0)
STRETCHES_M = (35.0, 80.0)
MIN_RADIUS_M = 14.0
STEEPEST = 0.09
CLEARANCE_M = 30.0  # between stretches that are not neighbours along the road
NEIGHBOURS_M = 80.0


def random_road(seed: int) -> tuple[Floats, tuple[Look, ...], NDArray[np.intp]]:
    """The points (N, 3) of a closed road in metres, its looks, and the number of each point's look (N,).

    From the origin, each direction meets the road once, so it cannot cross itself. A road that bends too sharply
    or comes too near to itself is drawn again, with the same random generator.
    """
    random = np.random.default_rng(seed)
    while True:
        points = _draw(random)
        line = Centreline(points)
        is_gentle = np.abs(line.curvature_per_m).max() <= 1 / MIN_RADIUS_M
        if is_gentle and line.clearance_m(NEIGHBOURS_M) > CLEARANCE_M:
            return points, *_dress(random, points)


def _draw(random: np.random.Generator) -> Floats:
    angle = np.linspace(0.0, 2 * np.pi, 4000, endpoint=False)
    radius = np.ones_like(angle)
    height = np.zeros_like(angle)
    for wave in range(2, 8):
        radius += random.normal(0.0, 0.45 / wave) * np.cos(wave * angle + random.uniform(0, 2 * np.pi))
        height += random.normal(0.0, 1.0 / wave) * np.cos(wave * angle + random.uniform(0, 2 * np.pi))
    radius = np.maximum(radius, 0.15)
    plan = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    if random.random() < 0.5:  # half of the roads are driven clockwise
        plan = plan[::-1]
    steps = np.hypot(*(np.roll(plan, -1, axis=0) - plan).T)
    plan *= random.uniform(*LENGTHS_M) / steps.sum()
    slope = (np.roll(height, -1) - height) / np.hypot(*(np.roll(plan, -1, axis=0) - plan).T)
    return np.column_stack([plan, height * random.uniform(0.1, 1.0) * STEEPEST / np.abs(slope).max()])


def _dress(random: np.random.Generator, points_m: Floats) -> tuple[tuple[Look, ...], NDArray[np.intp]]:
    """Random looks for stretches of random lengths, and the number of each point's look (N,)."""
    steps = np.hypot(*(np.roll(points_m, -1, axis=0) - points_m)[:, :2].T)
    arc = np.cumsum(steps)
    ends = np.cumsum(random.uniform(*STRETCHES_M, size=int(arc[-1] / STRETCHES_M[0]) + 1))
    index = np.searchsorted(ends, arc)
    return draw_looks(random, int(index.max()) + 1), index.astype(np.intp)


def draw_looks(random: np.random.Generator, count: int) -> tuple[Look, ...]:
    """Random looks of the two built-in tracks: four looks of one track, then four of the other, and so on."""
    looks: list[Look] = []
    first = int(random.integers(2))
    for k in range(count):
        source = (LAKE, MOUNTAIN)[(first + k // 4) % 2]
        looks.append(source[int(random.integers(len(source)))].look)
    return tuple(looks)
