"""Stretches of neighbouring positions or numbers, as pairs (first, last)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray


def stretches(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """The first and last position of every run of True in a mask (N,)."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False)).tolist()
    return [(first, end - 1) for first, end in zip(edges[::2], edges[1::2], strict=True)]


def within(numbers: NDArray[np.int64], pairs: Iterable[tuple[int, int]]) -> NDArray[np.bool_]:
    """A mask (N,) of the numbers (N,) that are in one of the stretches `pairs`."""
    mask = np.zeros(len(numbers), np.bool_)
    for first, last in pairs:
        mask |= (numbers >= first) & (numbers <= last)
    return mask


def consecutive(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """The first and last number of every run of consecutive integers. `numbers` must ascend."""
    values = np.array(numbers, np.int64)
    cuts = np.flatnonzero(np.diff(values) != 1) + 1
    return [(int(run[0]), int(run[-1])) for run in np.split(values, cuts) if len(run)]


def runs(changes: NDArray[np.bool_], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first and last position of each run among `count` positions. `changes` (count - 1,): the next position
    begins another run."""
    edges = np.flatnonzero(changes)
    return np.concatenate([[0], edges + 1])[:count], np.append(edges, count - 1)[:count]


def stretches_within(mask: NDArray[np.bool_], part: NDArray[np.int64]) -> list[tuple[int, int]]:
    """The first and last position of every run of True in a mask (N,) within one part. `part` (N,) has the number
    of the part of each position."""
    first, last = runs((mask[1:] != mask[:-1]) | (part[1:] != part[:-1]), len(mask))
    is_run = mask[first]
    return list(zip(first[is_run].tolist(), last[is_run].tolist(), strict=True))
