"""A map of things by their features: similar ones lie near each other. After UMAP (McInnes, Healy, Melville 2018,
arXiv 1802.03426), in NumPy: a graph of nearest neighbours, whose edges attract, and random others, which repel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

NEIGHBOURS: Final = 15
_DIMENSIONS: Final = 30  # in which neighbours are searched
_A, _B = 1.577, 0.895  # how near neighbours lie, as UMAP's min_dist of 0.1
ROUNDS: Final = 300
_REPELLED: Final = 10  # random others, in each round
_STEP: Final = 0.25  # the first round's; attraction of all neighbours at once overshoots with UMAP's 1.0
_MAX_MOVE: Final = 4.0
_BLOCK: Final = 1024  # rows of distances at once


class NeighbourMap(NamedTuple):
    """A map of N things."""

    place: Floats  # (N, 2)
    nearest: Floats  # (N,) the distance to the most similar thing; its median is 1
    alone: Floats  # (N,) the mean distance to the neighbours; its median is 1


def neighbour_map(features: Floats, on_round: Callable[[], object] = lambda: None) -> NeighbourMap:
    """The map of features (N, D). The same features give the same map on the same machine. `on_round` is called
    ROUNDS times."""
    count = len(features)
    reduced = principal(features, _DIMENSIONS)
    if count <= NEIGHBOURS + 1:
        return NeighbourMap(_two(reduced), np.ones(count, np.float32), np.ones(count, np.float32))
    neighbour, distance = _nearest(reduced)
    place = _laid_out(_two(reduced), neighbour, _weights(distance), on_round)
    return NeighbourMap(place, _usual(distance[:, 0]), _usual(distance.mean(1)))


def principal(features: Floats, dimensions: int) -> Floats:
    """The features (N, D) along their first principal axes: (N, at most `dimensions`)."""
    centred = features - features.mean(0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    axes = axes[:, ::-1][:, :dimensions]
    axes = axes * np.where(np.take_along_axis(axes, abs(axes).argmax(0)[None], 0) < 0, -1, 1)  # one of two signs
    reduced: Floats = (centred @ axes).astype(np.float32)
    return reduced


def groups(place: Floats, max_groups: int) -> NDArray[np.int32]:
    """The group of each place (N, 2) by k-means, which starts with places far from each other. 0 is the largest
    group."""
    centres = [place.mean(0)]
    gap = ((place - centres[0]) ** 2).sum(1)
    for _ in range(min(max_groups, len(place)) - 1):
        centres.append(place[gap.argmax()])
        gap = np.minimum(gap, ((place - centres[-1]) ** 2).sum(1))
    middle = np.array(centres)
    group = np.zeros(len(place), np.int64)
    for _ in range(30):
        group = ((place[:, None] - middle[None]) ** 2).sum(2).argmin(1)
        size = np.bincount(group, minlength=len(middle))
        for axis in (0, 1):
            total = np.bincount(group, place[:, axis], len(middle))
            middle[:, axis] = np.where(size, total / np.maximum(size, 1), middle[:, axis])
    order = np.argsort(-np.bincount(group, minlength=len(middle)), kind="stable")
    return np.argsort(order)[group].astype(np.int32)


def _two(reduced: Floats) -> Floats:
    """The first two axes, as wide as UMAP's start; zeros if all things are equal."""
    place = np.zeros((len(reduced), 2), np.float32)
    place[:, : min(2, reduced.shape[1])] = reduced[:, :2]
    return (place * (10 / (abs(place).max() or 1))).astype(np.float32)


def _usual(distance: Floats) -> Floats:
    return (distance / (np.median(distance) or 1)).astype(np.float32)


def _nearest(points: Floats) -> tuple[NDArray[np.int64], Floats]:
    """The nearest others of each of N points, and their ascending distances: both (N, NEIGHBOURS)."""
    squares = (points**2).sum(1)
    neighbours, distances = [], []
    for start in range(0, len(points), _BLOCK):
        block = points[start : start + _BLOCK]
        apart = squares - 2 * block @ points.T
        apart[np.arange(len(block)), np.arange(start, start + len(block))] = np.inf
        unsorted = np.argpartition(apart, NEIGHBOURS, 1)[:, :NEIGHBOURS]
        exact = np.linalg.norm(points[unsorted] - block[:, None], axis=2)  # the difference of squares loses digits
        order = exact.argsort(1, kind="stable")
        neighbours.append(np.take_along_axis(unsorted, order, 1))
        distances.append(np.take_along_axis(exact, order, 1))
    return np.concatenate(neighbours), np.concatenate(distances)


def _weights(distance: Floats) -> Floats:
    """The weight of each neighbour (N, NEIGHBOURS): 1 for the nearest; their sum is log2 of their number."""
    beyond = distance - distance[:, :1]
    low, high = np.zeros(len(distance)), np.full(len(distance), np.inf)
    width = np.ones(len(distance))
    for _ in range(40):
        too_much = np.exp(-beyond / width[:, None]).sum(1) > np.log2(NEIGHBOURS)
        high, low = np.where(too_much, width, high), np.where(too_much, low, width)
        width = np.where(np.isinf(high), width * 2, (low + high) / 2)
        width = np.clip(width, 1e-6, 1e6)
    return np.exp(-beyond / width[:, None]).astype(np.float32)


def _laid_out(
    place: Floats, neighbour: NDArray[np.int64], weight: Floats, on_round: Callable[[], object]
) -> Floats:
    count = len(place)
    random = np.random.default_rng(0)
    place = place + random.normal(0, 1e-3, place.shape).astype(np.float32)  # equal ones would never separate
    tail, head = np.repeat(np.arange(count), NEIGHBOURS), neighbour.ravel()
    pull = weight.ravel()
    pushed = (pull.reshape(count, -1).sum(1) / _REPELLED)[:, None, None] * 5  # UMAP's five others for each pull
    for number in range(ROUNDS):
        on_round()
        step = np.float32(_STEP * (1 - number / ROUNDS))
        apart = place[tail] - place[head]
        square = np.maximum((apart**2).sum(1), 1e-12)
        pulled = apart * (pull * -2 * _A * _B * square ** (_B - 1) / (1 + _A * square**_B))[:, None]
        others = place[:, None] - place[random.integers(0, count, (count, _REPELLED))]
        square = (others**2).sum(2, keepdims=True)
        moves = others * (2 * _B / ((0.001 + square) * (1 + _A * square**_B)))
        move = (np.clip(moves, -_MAX_MOVE, _MAX_MOVE) * pushed).sum(1)
        for axis in (0, 1):
            move[:, axis] += np.bincount(tail, pulled[:, axis], count) - np.bincount(head, pulled[:, axis], count)
        place = place + step * np.clip(move, -_MAX_MOVE, _MAX_MOVE)
    return place.astype(np.float32)
