"""Random closed roads with hairpins, from a seed: a car that does not slow down for the hairpins leaves the road.

A road is a ring with four to six corners. Two or three of its sides have a pair of hairpins like the mountain's,
one to the left and one to the right: the road turns back, and then forward again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.roads.centreline import Centreline, Floats
from simulator.roads.random_road import draw_looks
from simulator.roads.road_stretches import Look, Stretch, trace

CORNERS = (4, 6)
CORNER_RADII_M = (22.0, 45.0)
PAIRS = (2, 3)
HAIRPIN_RADII_M = (13.0, 14.5)  # the mountain's hairpins have 12.7 and 13.4 m
HAIRPIN_TURNS_DEG = (170.0, 185.0)
STRAIGHTS_M = (25.0, 65.0)  # before the straights are changed to close the loop
STEEPEST = (0.03, 0.12)
LENGTHS_M = (700.0, 1150.0)
CLEARANCE_M = 24.0  # between stretches that are not neighbours along the road, such as the arms of a hairpin
NEIGHBOURS_M = 60.0


def hairpin_road(seed: int) -> tuple[Floats, tuple[Look, ...], NDArray[np.intp]]:
    """The points (N, 3) of a closed road in metres, its looks, and the number of each point's look (N,).

    If a road cannot be closed, comes too near to itself, or is too short or too long, another one is drawn with
    the same random generator. About one in fourteen is used.
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
        if LENGTHS_M[0] < line.length_m < LENGTHS_M[1] and line.clearance_m(NEIGHBOURS_M) > CLEARANCE_M:
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
    steepest: Floats = grades * random.uniform(*STEEPEST) / np.abs(grades).max()
    return steepest
