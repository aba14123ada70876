"""The centre line of a road: held against a circle, whose arcs, directions and distances are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from simulator.roads.centreline import Centreline

RADIUS_M = 20.0
LENGTH_M = math.tau * RADIUS_M


@pytest.fixture(scope="module")
def circle() -> Centreline:
    """Driven to the left, from the place that is the farthest to the east."""
    angle = np.linspace(0, math.tau, 2000, endpoint=False)
    return Centreline(np.stack([RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), np.sin(angle)], axis=1))


@pytest.mark.parametrize("arc_m", [-7.3, 0.0, 0.2, 31.1, LENGTH_M - 0.1, LENGTH_M + 40.4])
def test_a_place_lies_between_its_points_also_across_the_seam(circle: Centreline, arc_m: float) -> None:
    angle = arc_m / RADIUS_M
    place = circle.at(arc_m)
    assert (place.x_m, place.y_m) == pytest.approx(
        (RADIUS_M * math.cos(angle), RADIUS_M * math.sin(angle)), abs=0.005
    )
    assert place.z_m == pytest.approx(math.sin(angle), abs=0.001)
    assert math.remainder(place.heading_rad - angle - math.pi / 2, math.tau) == pytest.approx(0, abs=0.001)
    assert place.curvature_per_m == pytest.approx(1 / RADIUS_M, rel=0.01)
    assert place.slope == pytest.approx(math.cos(angle) / RADIUS_M, abs=0.001)


@pytest.mark.parametrize("near", [True, False])
@pytest.mark.parametrize("to_the_left_m", [-3.0, 0.0, 2.0])
def test_the_nearest_place_and_the_distance_from_it(circle: Centreline, to_the_left_m: float, near: bool) -> None:
    for arc_m in np.linspace(0.1, LENGTH_M - 0.1, 50).tolist():
        away_m, angle = RADIUS_M - to_the_left_m, arc_m / RADIUS_M
        place = away_m * math.cos(angle), away_m * math.sin(angle)
        found_m, offset_m = circle.project(*place, arc_m + 20 if near else None)
        assert math.remainder(found_m - arc_m, circle.length_m) == pytest.approx(0, abs=0.06)
        assert offset_m == pytest.approx(to_the_left_m, abs=0.005)


@pytest.mark.parametrize("near_arc_m", [1.0, 60.0, LENGTH_M - 1.0])
def test_what_is_farther_than_30_m_along_the_road_is_not_looked_at(circle: Centreline, near_arc_m: float) -> None:
    """The car is where the road is half a lap further."""
    angle = near_arc_m / RADIUS_M + math.pi
    found_m, _ = circle.project(RADIUS_M * math.cos(angle), RADIUS_M * math.sin(angle), near_arc_m)
    away_m = abs(math.remainder(found_m - near_arc_m, circle.length_m))
    assert 29 < away_m < 55  # the end of the stretch, and along its direction from there; half a lap is 63 m
