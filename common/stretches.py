"""Stretches of neighbours, as pairs of a first and a last one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def stretches(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last position of every run of True in a mask (N,)."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False)).tolist()
    return [(first, end - 1) for first, end in zip(edges[::2], edges[1::2], strict=True)]


def consecutive(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of every run of consecutive whole numbers, which ascend."""
    found = np.array(numbers, np.int64)
    cuts = np.flatnonzero(np.diff(found) != 1) + 1
    return [(int(part[0]), int(part[-1])) for part in np.split(found, cuts) if len(part)]
