"""Tracks by name, and the promises that their roads keep."""

import numpy as np
import pytest

from simulator.roads.track import Track, load_track

NAMES = ["lake", "mountain", "random:7", "hairpins:7"]


@pytest.mark.parametrize("name", NAMES)
def test_a_road_is_closed_and_even(name: str) -> None:
    points = load_track(name).line.points_m
    steps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    assert steps.max() < 0.6  # the step from the last point to the first included
    assert steps.min() > 0.4


@pytest.mark.parametrize(
    ("name", "length_m", "half_width_m", "radius_m", "slope"),
    [
        ("lake", (900, 1200), (4.0, 5.0), (25, 40), (0.0, 0.03)),
        ("mountain", (900, 1200), (3.5, 4.0), (11, 14), (0.10, 0.15)),
        ("random:7", (600, 1200), (3.5, 5.0), (14, 100), (0.0, 0.10)),
        ("random:8", (600, 1200), (3.5, 5.0), (14, 100), (0.0, 0.10)),
    ],
)
def test_a_road_has_the_promised_measures(
    name: str,
    length_m: tuple[float, float],
    half_width_m: tuple[float, float],
    radius_m: tuple[float, float],
    slope: tuple[float, float],
) -> None:
    track = load_track(name)
    assert length_m[0] <= track.line.length_m <= length_m[1]
    assert track.half_width_m.shape == (len(track.line.points_m),)
    assert half_width_m[0] <= track.half_width_m.min() <= track.half_width_m.max() <= half_width_m[1]
    # The radius from three points 3 m apart: independent of the centre line's own curvature.
    a, b, c = (np.roll(track.line.points_m[:, :2], k, axis=0) for k in (6, 0, -6))
    (ux, uy), (vx, vy) = (b - a).T, (c - b).T
    sides = np.hypot(ux, uy) * np.hypot(vx, vy) * np.hypot(ux + vx, uy + vy)
    curvature = 2 * np.abs(ux * vy - uy * vx) / sides
    assert radius_m[0] <= 1 / curvature.max() <= radius_m[1]
    rise = np.diff(track.line.points_m[:, 2])
    steepest = float(np.abs(rise / np.hypot(*np.diff(track.line.points_m[:, :2], axis=0).T)).max())
    assert slope[0] <= steepest <= slope[1]


@pytest.mark.parametrize("name", ["lake", "mountain", "random:0", "random:3", "random:7"])
def test_a_road_keeps_its_distance_from_itself(name: str) -> None:
    line, widest = load_track(name).line, float(load_track(name).half_width_m.max())
    plan = line.points_m[::3, :2]
    arc = np.arange(len(plan)) * 3 * line.step_m
    apart = np.abs(arc[:, None] - arc[None])
    apart = np.minimum(apart, line.length_m - apart)
    distance = np.linalg.norm(plan[:, None] - plan[None], axis=2)
    assert distance[apart > 60.0].min() >= 3 * 2 * widest


def hairpins(track: Track) -> tuple[int, int]:
    """How many bends turn by more than 150 degrees within 50 m, to the left and to the right."""
    x, y = (np.concatenate([axis, axis]) for axis in track.line.points_m[:, :2].T)
    heading = np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
    reach, count = round(50.0 / track.line.step_m), len(track.line.points_m)
    turned = np.degrees(heading[reach : reach + count] - heading[:count])
    starts = [(side * turned > 150.0) & (side * np.roll(turned, 1) <= 150.0) for side in (1, -1)]
    return int(starts[0].sum()), int(starts[1].sum())


def test_hairpin_roads_keep_what_they_promise_whatever_the_seed() -> None:
    lengths = set()
    for seed in range(10):
        track = load_track(f"hairpins:{seed}")
        line = track.line
        left, right = hairpins(track)
        assert left == right >= 2
        assert 700 <= line.length_m <= 1150
        assert 12.7 <= 1 / np.abs(line.curvature_per_m).max() <= 14.5  # the mountain's: 12.7 and 13.4 m
        steps = np.roll(line.points_m, -1, axis=0) - line.points_m
        slope = np.abs(steps[:, 2]) / np.hypot(steps[:, 0], steps[:, 1])
        assert 0.02 < slope.max() < 0.13
        plan = line.points_m[::5, :2]
        arc = np.arange(len(plan)) * 5 * line.step_m
        apart = np.abs(arc[:, None] - arc[None])
        apart = np.minimum(apart, line.length_m - apart)
        assert np.linalg.norm(plan[:, None] - plan[None], axis=2)[apart > 60.0].min() > 23.0
        lengths.add(line.length_m)
    assert len(lengths) == 10
    assert hairpins(load_track("mountain")) == (2, 2)


@pytest.mark.parametrize(
    ("name", "length_m", "at_300_m"),
    [("random:7", 843.816, (-76.571, -87.029, 0.114)), ("hairpins:7", 834.135, (69.432, -189.623, 1.926))],
)
def test_a_name_is_the_same_road_in_every_version(
    name: str, length_m: float, at_300_m: tuple[float, float, float]
) -> None:
    """Logs and studies name roads. These numbers are of the version that made the first road of the kind."""
    line = load_track(name).line
    place = line.at(300.0)
    assert line.length_m == pytest.approx(length_m, abs=0.01)
    assert (place.x_m, place.y_m, place.z_m) == pytest.approx(at_300_m, abs=0.01)


@pytest.mark.parametrize("kind", ["random", "hairpins"])
def test_a_seed_is_a_road(kind: str) -> None:
    first, again, other = (load_track(f"{kind}:{seed}") for seed in (7, 7, 8))
    assert np.array_equal(first.line.points_m, again.line.points_m)
    assert first.looks == again.looks
    assert first.fingerprint() == again.fingerprint()
    assert first.line.length_m != other.line.length_m
    assert first.fingerprint() != other.fingerprint()


def test_an_unknown_name_is_explained() -> None:
    for name in ("", "sea", "Lake", "random", "random:", "random:-1", "random:x", "random:1.5", "hairpins:x"):
        with pytest.raises(ValueError, match="Choose lake, mountain, random:SEED or hairpins:SEED"):
            load_track(name)
    with pytest.raises(ValueError, match=r"no such track\."):
        load_track("sea")
