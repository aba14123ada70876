"""Steering bins, and how many samples each may have.

Most driving is straight on: without balancing, a network that always predicts 0 is nearly right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


def bin_of(steering: NDArray[np.float64], bins: int) -> NDArray[np.int64]:
    """Which of `bins` equal bins over -1..1 each steering falls into: 0 (left) .. bins - 1 (right).

    An edge belongs to the bin farther from zero, on both sides: a mirrored distribution has mirrored counts.
    """
    outward = np.minimum(np.floor((np.abs(steering) + 1.0) * (bins / 2.0)).astype(np.int64), bins - 1)
    return np.where(steering >= 0, outward, bins - 1 - outward)


@dataclass(frozen=True)
class Balanced:
    """Which candidates to use. `chosen` are positions in what was balanced; a copy repeats an original."""

    chosen: NDArray[np.int64]
    is_copy: NDArray[np.bool_]
    per_bin: int  # what every bin was brought to
    short: dict[int, int]  # bins that the cap left below it, and how many samples they lack


def balance(bin_index: NDArray[np.int64], bins: int, max_uses: int, random: np.random.Generator) -> Balanced:
    """Bring every bin that is not empty to their mean count.

    A bin above the mean is pruned at random to it. A bin below is filled up to it with copies, spread evenly
    over its originals, of which none is used more than `max_uses` times (itself included).
    """
    counts = np.bincount(bin_index, minlength=bins)
    filled = np.flatnonzero(counts)
    if not len(filled):
        return Balanced(np.zeros(0, np.int64), np.zeros(0, np.bool_), 0, {})
    per_bin = round(float(counts[filled].mean()))
    chosen: list[NDArray[np.int64]] = []
    is_copy: list[NDArray[np.bool_]] = []
    short: dict[int, int] = {}
    order = np.argsort(bin_index, kind="stable")
    for index, members in zip(filled, np.split(order, np.cumsum(counts[filled])[:-1]), strict=True):
        originals = members if len(members) <= per_bin else np.sort(random.permutation(members)[:per_bin])
        wanted = min(per_bin, len(originals) * max_uses) - len(originals)
        rounds = [random.permutation(originals) for _ in range(-(-wanted // len(originals)))]
        copies = np.concatenate([*rounds, originals[:0]])[:wanted]
        if len(originals) + len(copies) < per_bin:
            short[int(index)] = per_bin - len(originals) - len(copies)
        chosen += [originals, copies]
        is_copy += [np.zeros(len(originals), np.bool_), np.ones(len(copies), np.bool_)]
    return Balanced(np.concatenate(chosen), np.concatenate(is_copy), per_bin, short)
