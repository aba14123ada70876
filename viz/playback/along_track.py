"""How far along a way other cars are."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Way = NDArray[np.float64]

FAR_M: Final = 10.0
"""Where most places are farther off than that, it is another road."""

_AHEAD_M: Final = 40.0  # how far it is looked for the next place: a road may come near itself farther on


def along(way: Way, other: Way) -> NDArray[np.float64] | None:
    """How far along `way` (N, 2) each point of `other` (M, 2) is, in m: the nearest point of it that is not behind
    the one before. None if `other` is of another road.

    What goes on behind the end of `way` is measured by itself, and does not tell whose road it is.
    """
    lengths = _lengths(way)
    start, off_m = _first(way, lengths, other[0])
    steps_m = np.concatenate([[0.0], np.hypot(*np.diff(other, axis=0).T)])
    placed = np.empty(len(other))
    offs_m = [off_m]
    at, beyond_m = start, 0.0
    for number, (point, step_m) in enumerate(zip(other, steps_m, strict=True)):
        if at == len(way) - 1:
            beyond_m += step_m if number else 0.0
        else:
            end = int(np.searchsorted(lengths, lengths[at] + _AHEAD_M, "right"))
            distances = np.hypot(*(way[at:end] - point).T)
            at += int(np.argmin(distances))
            offs_m.append(float(distances.min()))
        placed[number] = lengths[at] + beyond_m
    return placed if np.median(offs_m) <= FAR_M else None


def _lengths(way: Way) -> NDArray[np.float64]:
    """From the beginning of `way` to each of its points, in m."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])


def _first(way: Way, lengths: NDArray[np.float64], point: Way) -> tuple[int, float]:
    """The earliest place about as near as the nearest: a lap ends where it began. Its number and distance."""
    distances = np.hypot(*(way - point).T)
    near = distances <= 1.5 * distances.min() + 2.0
    begin = int(np.argmax(near))
    end = int(np.searchsorted(lengths, lengths[begin] + 2 * _AHEAD_M, "right"))
    at = begin + int(np.argmin(distances[begin:end]))
    return at, float(distances[at])
