"""Balancing: the number of samples in each steering bin.

Most driving is straight ahead: without balancing, a network that always predicts 0 has small errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

PerBin = Literal["mean", "median"] | int


@dataclass(frozen=True)
class Balanced:
    """The chosen candidates: their positions, and whether each is a copy of another one."""

    chosen: NDArray[np.int64]
    is_copy: NDArray[np.bool_]
    per_bin: int  # target for every bin; 0: not balanced
    short: dict[int, int]  # missing samples of each bin that `max_uses` kept below the target


def balance(
    bin_index: NDArray[Any], bins: int, max_uses: int, random: np.random.Generator, per_bin: PerBin = "mean"
) -> Balanced:
    """Bring every non-empty bin to the same number of samples: the mean of the bins, their median, or a number.

    A larger bin is reduced at random. A smaller bin is filled with copies, distributed evenly over its originals.
    An original is used at most `max_uses` times, including itself.
    """
    counts = np.bincount(bin_index, minlength=bins)
    filled = np.flatnonzero(counts)
    target = _target(counts[filled], per_bin) if len(filled) else 0
    chosen: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    is_copy: list[NDArray[np.bool_]] = [np.zeros(0, np.bool_)]
    short: dict[int, int] = {}
    # 16 bits are enough for all bins, and NumPy's stable sort of 16-bit integers takes linear time
    order = np.argsort(bin_index.astype(np.int16), kind="stable")
    ends = np.cumsum(counts)
    for index in filled.tolist():
        members = order[ends[index] - counts[index] : ends[index]]
        originals = members if len(members) <= target else np.sort(random.choice(members, target, replace=False))
        copied = min(target, len(originals) * max_uses) - len(originals)
        rounds = [random.permutation(originals) for _ in range(-(-copied // len(originals)))]
        copies = np.concatenate([*rounds, originals[:0]])[:copied]
        chosen += [originals, copies]
        is_copy += [np.zeros(len(originals), np.bool_), np.ones(len(copies), np.bool_)]
        if lacking := target - len(originals) - copied:
            short[index] = lacking
    return Balanced(np.concatenate(chosen), np.concatenate(is_copy), target, short)


def _target(counts: NDArray[np.int64], per_bin: PerBin) -> int:
    if per_bin == "mean":
        return round(float(counts.mean()))
    if per_bin == "median":
        return round(float(np.median(counts)))
    return int(per_bin)
