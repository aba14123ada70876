"""The layout of a map: alike things lie near each other, the same way each time."""

from __future__ import annotations

import numpy as np
import pytest

from web.processes.neighbour_map import ROUNDS, groups, neighbour_map

KINDS, EACH = 4, 60


def blobs() -> tuple[np.ndarray, np.ndarray]:
    """Things of four kinds (N, 50), in no order, and their kinds (N,)."""
    random = np.random.default_rng(3)
    centres = random.normal(0, 10, (KINDS, 50))
    kind = random.permutation(np.repeat(np.arange(KINDS), EACH))
    return (centres[kind] + random.normal(0, 1, (len(kind), 50))).astype(np.float32), kind


def test_alike_things_lie_near_each_other() -> None:
    features, kind = blobs()
    rounds = []
    layout = neighbour_map(features, lambda: rounds.append(1))
    assert len(rounds) == ROUNDS
    apart = np.linalg.norm(layout.place[:, None] - layout.place[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    assert (kind[apart.argmin(1)] == kind).all()
    is_same = kind[:, None] == kind[None]
    np.fill_diagonal(is_same, False)
    assert apart[is_same].max() < np.median(apart[~is_same & np.isfinite(apart)])
    assert (neighbour_map(features).place == layout.place).all()


def test_lonely_ones_and_doubles_stand_out() -> None:
    features, _ = blobs()
    features[7] = features[11]
    features[20] += 100
    layout = neighbour_map(features)
    assert layout.alone.argmax() == 20
    assert set(np.flatnonzero(layout.nearest < 0.1)) == {7, 11}
    assert np.median(layout.nearest) == pytest.approx(1)


def test_groups_are_those_that_lie_together_the_largest_first() -> None:
    random = np.random.default_rng(0)
    places = [random.normal(at, 0.1, (count, 2)) for at, count in (((0, 0), 20), ((9, 0), 70), ((0, 9), 40))]
    group = groups(np.concatenate(places).astype(np.float32), 3)
    assert [set(part) for part in np.split(group, [20, 90])] == [{2}, {0}, {1}]
    assert set(groups(np.zeros((3, 2), np.float32), 24)) == {0}
