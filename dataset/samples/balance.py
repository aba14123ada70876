"""Balancing: how many samples each steering bin may have.

Most driving is straight on: without balancing, a network that always predicts 0 is nearly right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

PerBin = Literal["mean", "median"] | int


@dataclass(frozen=True)
class Balanced:
    """The candidates to use. `chosen` are positions in what was balanced; a copy repeats an original."""

    chosen: NDArray[np.int64]
    is_copy: NDArray[np.bool_]
    per_bin: int  # what every bin was brought to; 0 where nothing was
    short: dict[int, int]  # bins that the cap left below it, and how many samples they lack


@dataclass(frozen=True)
class Quota:
    """The number of samples that each bin gives: candidates used once, and copies of these; (bins,)."""

    originals: NDArray[np.int64]
    copies: NDArray[np.int64]


def balance(
    bin_index: NDArray[Any], bins: int, max_uses: int, random: np.random.Generator, per_bin: PerBin = "mean"
) -> Balanced:
    """Bring every bin that is not empty to one count: their mean, their median, or a number.

    A bin above it is pruned at random to it. A bin below is filled up to it with copies, spread evenly over its
    originals. None is used more than `max_uses` times (itself included).
    """
    quota, target, short = quota_of(np.bincount(bin_index, minlength=bins), max_uses, per_bin)
    chosen, is_copy = draw(bin_index, quota, random)
    return Balanced(chosen, is_copy, target, short)


def quota_of(counts: NDArray[np.int64], max_uses: int, per_bin: PerBin) -> tuple[Quota, int, dict[int, int]]:
    """The quota of bins with `counts` candidates, the count that each is brought to, and what bins lack of it."""
    filled = np.flatnonzero(counts)
    target = _target(counts[filled], per_bin) if len(filled) else 0
    originals = np.minimum(counts, target)
    copies = np.minimum(target, originals * max_uses) - originals
    lacking = target - originals - copies
    return (
        Quota(originals, copies),
        target,
        {each: int(lacking[each]) for each in filled.tolist() if lacking[each]},
    )


def draw(
    bin_index: NDArray[Any], quota: Quota, random: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Positions in `bin_index`, as many of each bin as the quota has; and a mask of those that are copies."""
    counts = np.bincount(bin_index, minlength=len(quota.originals))
    chosen: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    is_copy: list[NDArray[np.bool_]] = [np.zeros(0, np.bool_)]
    # so few bins fit into 16 bits, whose stable sort takes linear time
    order = np.argsort(bin_index.astype(np.int16), kind="stable")
    ends = np.cumsum(counts)
    for index in np.flatnonzero(quota.originals).tolist():
        members = order[ends[index] - counts[index] : ends[index]]
        wanted, copied = int(quota.originals[index]), int(quota.copies[index])
        originals = members if len(members) == wanted else np.sort(random.choice(members, wanted, replace=False))
        rounds = [random.permutation(originals) for _ in range(-(-copied // wanted))]
        copies = np.concatenate([*rounds, originals[:0]])[:copied]
        chosen += [originals, copies]
        is_copy += [np.zeros(len(originals), np.bool_), np.ones(len(copies), np.bool_)]
    return np.concatenate(chosen), np.concatenate(is_copy)


def shares(quota: Quota, counts: NDArray[np.int64]) -> list[Quota]:
    """Divide a quota among sessions that have `counts` (sessions, bins) candidates: each has its share of every
    bin, to within one sample, and its originals are copied as often as all others'."""
    originals = _shared(quota.originals, counts)
    rounds, rest = np.divmod(quota.copies, np.maximum(quota.originals, 1))
    copies = originals * rounds + _shared(rest, originals)
    return [Quota(*of_session) for of_session in zip(originals, copies, strict=True)]


def _shared(wanted: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """The `wanted` number of each bin, divided among sessions (sessions, bins) in proportion to `counts`."""
    total = np.maximum(counts.sum(axis=0), 1)
    # 64 bits hold the square of three billion, and more are in no bin
    up_to: NDArray[np.int64] = np.cumsum(counts, axis=0) * wanted // total
    return np.diff(up_to, axis=0, prepend=0)


def unbalanced(count: int) -> Balanced:
    """Every one of `count` candidates once."""
    return Balanced(np.arange(count), np.zeros(count, np.bool_), 0, {})


def _target(counts: NDArray[np.int64], per_bin: PerBin) -> int:
    if per_bin == "mean":
        return round(float(counts.mean()))
    if per_bin == "median":
        return round(float(np.median(counts)))
    return int(per_bin)
