"""Distances of other cars along a driven path."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Path2D = NDArray[np.float64]

FAR_M: Final = 10.0
"""A path whose median distance is larger is on another road."""

_AHEAD_M: Final = 40.0  # how far it is looked for the next place: a road may come near itself farther on


def distances_along(path: Path2D, other: Path2D) -> NDArray[np.float64] | None:
    """Distances along `path` (N, 2) of the points of `other` (M, 2), in m: each at the nearest point of `path` not
    behind the one before. None if `other` is on another road.

    Beyond the end of `path`, `other` is measured along itself, and may leave the road.
    """
    lengths = _lengths(path)
    start, off_m = _first(path, lengths, other[0])
    steps_m = np.concatenate([[0.0], np.hypot(*np.diff(other, axis=0).T)])
    placed = np.empty(len(other))
    offs_m = [off_m]
    at, beyond_m = start, 0.0
    for number, (point, step_m) in enumerate(zip(other, steps_m, strict=True)):
        if at == len(path) - 1:
            beyond_m += step_m if number else 0.0
        else:
            end = int(np.searchsorted(lengths, lengths[at] + _AHEAD_M, "right"))
            distances = np.hypot(*(path[at:end] - point).T)
            at += int(np.argmin(distances))
            offs_m.append(float(distances.min()))
        placed[number] = lengths[at] + beyond_m
    return placed if np.median(offs_m) <= FAR_M else None


def _lengths(path: Path2D) -> NDArray[np.float64]:
    """Distances from the beginning of `path` to each of its points, in m."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])


def _first(path: Path2D, lengths: NDArray[np.float64], point: Path2D) -> tuple[int, float]:
    """The earliest place about as near as the nearest: a lap ends where it began. Its number and distance."""
    distances = np.hypot(*(path - point).T)
    near = distances <= 1.5 * distances.min() + 2.0
    begin = int(np.argmax(near))
    end = int(np.searchsorted(lengths, lengths[begin] + 2 * _AHEAD_M, "right"))
    at = begin + int(np.argmin(distances[begin:end]))
    return at, float(distances[at])
