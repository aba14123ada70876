"""Blocks of time within drives, and their split into training and validation.

Neighbouring frames are nearly the same picture. With a random split, validation would test pictures that training
has seen. With a split by blocks of time, it tests stretches of road that training has not seen.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray


def block_numbers(time_ns: NDArray[np.int64], drive: NDArray[np.int64], block_s: float) -> NDArray[np.int64]:
    """The number of the block of each row (N,), from 0. A block is `block_s` seconds long, within one drive."""
    if not len(time_ns):
        return np.zeros(0, np.int64)
    first = np.flatnonzero(np.concatenate([[True], np.diff(drive) != 0]))
    start_ns = np.repeat(time_ns[first], np.diff(np.append(first, len(time_ns))))
    within = ((time_ns - start_ns) // int(block_s * 1e9)).astype(np.int64)
    changes = (np.diff(drive) != 0) | (np.diff(within) != 0)
    return np.concatenate([[0], np.cumsum(changes)])


def validation_blocks(block: NDArray[np.int64], share: float, seed: int, session: str) -> NDArray[np.int64]:
    """The blocks of a session for validation: about `share` of its frames, chosen at random.

    The choice depends only on the seed, the session's name and its frames, so that a new session does not change
    the split of the others. A session with a single block is all for training.
    """
    numbers, frames = np.unique(block, return_counts=True)
    if len(numbers) < 2 or share <= 0:
        return numbers[:0]
    digest = hashlib.sha256(f"{seed}/{session}".encode()).digest()
    order = np.random.default_rng(int.from_bytes(digest[:8], "little")).permutation(len(numbers))
    taken = np.cumsum(frames[order])
    # the number of blocks with a share closest to `share`; at least one, and never all
    count = int(np.argmin(np.abs(taken[:-1] - share * len(block)))) + 1
    return np.sort(numbers[order[:count]])


def near_validation(
    time_ns: NDArray[np.int64], is_validation: NDArray[np.bool_], gap_s: float
) -> NDArray[np.bool_]:
    """A mask (N,) of the training rows within `gap_s` of a validation row, along the recording.

    The pictures on both sides of a block's edge are nearly the same, so these rows are left out of both splits.
    The time is the sum of the absolute steps from row to row: if the clock was set back, neighbours still show the
    same place.
    """
    if not len(time_ns):
        return np.zeros(0, np.bool_)
    elapsed_ns = np.concatenate([[0], np.cumsum(np.abs(np.diff(time_ns)))])
    before = _since_last(elapsed_ns, is_validation)
    after = _since_last(-elapsed_ns[::-1], is_validation[::-1])[::-1]
    return (np.minimum(before, after) <= gap_s * 1e9) & ~is_validation


def _since_last(elapsed_ns: NDArray[np.int64], mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The time in ns from the last marked row to each row (N,); infinite if no row before is marked."""
    last = np.maximum.accumulate(np.where(mask, np.arange(len(mask)), -1))
    return np.where(last >= 0, (elapsed_ns - elapsed_ns[last]).astype(np.float64), np.inf)
