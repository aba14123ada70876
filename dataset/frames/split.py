"""Blocks of time within drives, and their split into training and validation.

Neighbouring frames are nearly the same picture. Split at random, validation would ask what training has
seen; split by blocks of time, it asks about stretches of road that training has not seen.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray


def block_numbers(time_ns: NDArray[np.int64], drive: NDArray[np.int64], block_s: float) -> NDArray[np.int64]:
    """Numbers the blocks of a session from 0: stretches of `block_s` seconds within one drive."""
    if not len(time_ns):
        return np.zeros(0, np.int64)
    first = np.flatnonzero(np.concatenate([[True], np.diff(drive) != 0]))
    start_ns = np.repeat(time_ns[first], np.diff(np.append(first, len(time_ns))))
    within = ((time_ns - start_ns) // int(block_s * 1e9)).astype(np.int64)
    changes = (np.diff(drive) != 0) | (np.diff(within) != 0)
    return np.concatenate([[0], np.cumsum(changes)])


def validation_blocks(block: NDArray[np.int64], share: float, seed: int, session: str) -> NDArray[np.int64]:
    """The blocks of a session that are for validation: about `share` of its frames, chosen at random.

    Depends on the session's name and frames alone, so that adding a session moves no other's split.
    A session of a single block is all training.
    """
    numbers, frames = np.unique(block, return_counts=True)
    if len(numbers) < 2 or share <= 0:
        return numbers[:0]
    digest = hashlib.sha256(f"{seed}/{session}".encode()).digest()
    order = np.random.default_rng(int.from_bytes(digest[:8], "little")).permutation(len(numbers))
    taken = np.cumsum(frames[order])
    # the number of blocks that comes closest to the share; at least one, and never all
    count = int(np.argmin(np.abs(taken[:-1] - share * len(block)))) + 1
    return np.sort(numbers[order[:count]])


def near_validation(
    time_ns: NDArray[np.int64], is_validation: NDArray[np.bool_], gap_s: float
) -> NDArray[np.bool_]:
    """Rows for training that lie within `gap_s` of one for validation, along the recording.

    A picture just before the edge of a block is nearly the one just behind it; these are left out of both. Time
    is added up from row to row, forward also where a clock was set back: the place was still the same.
    """
    if not len(time_ns):
        return np.zeros(0, np.bool_)
    elapsed_ns = np.concatenate([[0], np.cumsum(np.abs(np.diff(time_ns)))])
    before = _since_last(elapsed_ns, is_validation)
    after = _since_last(-elapsed_ns[::-1], is_validation[::-1])[::-1]
    return (np.minimum(before, after) <= gap_s * 1e9) & ~is_validation


def _since_last(elapsed_ns: NDArray[np.int64], mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """For each row the time in ns to the last marked row at or before it; infinite without one."""
    last = np.maximum.accumulate(np.where(mask, np.arange(len(mask)), -1))
    return np.where(last >= 0, (elapsed_ns - elapsed_ns[last]).astype(np.float64), np.inf)
