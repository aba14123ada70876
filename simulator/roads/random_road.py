"""Random closed roads from a seed, for evaluation on roads that training has not used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.roads.built_in_tracks import LAKE, MOUNTAIN
from simulator.roads.centreline import Centreline, Floats
from simulator.roads.road_stretches import Look, Stretch, trace

_RANDOM_LENGTHS_M = (650.0, 1150.0)
STRETCHES_M = (35.0, 80.0)
MIN_RADIUS_M = 14.0
_RANDOM_STEEPEST = 0.09
_RANDOM_CLEARANCE_M = 30.0  # between stretches that are not neighbours along the road
_RANDOM_NEIGHBOURS_M = 80.0


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
        if is_gentle and line.clearance_m(_RANDOM_NEIGHBOURS_M) > _RANDOM_CLEARANCE_M:
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
    plan *= random.uniform(*_RANDOM_LENGTHS_M) / steps.sum()
    slope = (np.roll(height, -1) - height) / np.hypot(*(np.roll(plan, -1, axis=0) - plan).T)
    return np.column_stack([plan, height * random.uniform(0.1, 1.0) * _RANDOM_STEEPEST / np.abs(slope).max()])


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


CORNERS = (4, 6)
CORNER_RADII_M = (22.0, 45.0)
PAIRS = (2, 3)
HAIRPIN_RADII_M = (13.0, 14.5)  # the mountain's hairpins have 12.7 and 13.4 m
HAIRPIN_TURNS_DEG = (170.0, 185.0)
STRAIGHTS_M = (25.0, 65.0)  # before the straights are changed to close the loop
_HAIRPIN_STEEPEST = (0.03, 0.12)
_HAIRPIN_LENGTHS_M = (700.0, 1150.0)
_HAIRPIN_CLEARANCE_M = 24.0  # also between the arms of a hairpin
_HAIRPIN_NEIGHBOURS_M = 60.0


def hairpin_road(seed: int) -> tuple[Floats, tuple[Look, ...], NDArray[np.intp]]:
    """As `random_road`, with hairpins: a car that does not slow down for them leaves the road.

    A road is a ring with four to six corners. Two or three of its sides have a pair of hairpins like the
    mountain's, one to the left and one to the right. A road that cannot be
    closed, comes too near to itself, or is too short or too long is drawn again, with the same random generator.
    About one in fourteen is used.
    """
    random = np.random.default_rng(seed)
    while True:
        bends = _draw_bends(random)
        looks = draw_looks(random, len(bends))
        grades = _draw_grades(random, len(bends))
        stretches = [
            Stretch(length_m, turn_deg, float(grade), look)
            for (length_m, turn_deg), grade, look in zip(bends, grades, looks, strict=True)
        ]
        try:
            points, index = trace(stretches)
        except ValueError:  # the road cannot be closed
            continue
        line = Centreline(points)
        if (
            _HAIRPIN_LENGTHS_M[0] < line.length_m < _HAIRPIN_LENGTHS_M[1]
            and line.clearance_m(_HAIRPIN_NEIGHBOURS_M) > _HAIRPIN_CLEARANCE_M
        ):
            return points, looks, index


def _draw_bends(random: np.random.Generator) -> list[tuple[float, float]]:
    """Lengths in metres and turns in degrees, positive to the left. The turns add up to 360 or -360 degrees."""
    corners = int(random.integers(CORNERS[0], CORNERS[1] + 1))
    pairs = int(random.integers(PAIRS[0], PAIRS[1] + 1))
    has_pair = random.permutation(corners) < pairs
    hairpins_deg = random.uniform(*HAIRPIN_TURNS_DEG, size=(corners, 2)) * has_pair[:, None]
    hairpins_deg *= random.choice([(1.0, -1.0), (-1.0, 1.0)], size=corners)  # the direction of the first hairpin
    corners_deg = random.uniform(0.5, 1.5, size=corners)
    corners_deg *= (360.0 - hairpins_deg.sum()) / corners_deg.sum()
    bends = []
    for corner_deg, pair_deg in zip(corners_deg, hairpins_deg, strict=True):
        bends.append((random.uniform(*STRAIGHTS_M), 0.0))
        for turn_deg in pair_deg[pair_deg != 0.0]:
            bends.append((_arc_m(random.uniform(*HAIRPIN_RADII_M), turn_deg), turn_deg))
            bends.append((random.uniform(*STRAIGHTS_M), 0.0))
        bends.append((_arc_m(random.uniform(*CORNER_RADII_M), corner_deg), corner_deg))
    side = random.choice([-1.0, 1.0])
    return [(length_m, side * turn_deg) for length_m, turn_deg in bends]


def _arc_m(radius_m: float, turn_deg: float) -> float:
    return float(radius_m * np.radians(abs(turn_deg)))


def _draw_grades(random: np.random.Generator, count: int) -> Floats:
    """Grades (count,), rise over run: one or two uneven climbs and descents around the road, with a random
    maximum."""
    turn = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    grades = np.sin(random.integers(1, 3) * turn + random.uniform(0, 2 * np.pi)) + random.normal(0.0, 0.4, count)
    grades -= grades.mean()
    steepest: Floats = grades * random.uniform(*_HAIRPIN_STEEPEST) / np.abs(grades).max()
    return steepest
