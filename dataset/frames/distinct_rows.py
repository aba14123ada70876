"""Numbering of rows that are alike: samples of one picture, frames of one moment."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def number_distinct(*columns: NDArray[Any]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Number the different rows of some columns, sorted by the last: (each row's number, where a number is met).

    The samples of one picture mostly follow one another, so that only few of the rows have to be sorted.
    """
    count = len(columns[0])
    if not count:
        return np.zeros(0, np.int32), np.zeros(0, np.int64)
    head = _changes(columns)
    heads = np.flatnonzero(head)
    order = np.lexsort([column[heads] for column in columns])
    ranked = heads[order]
    is_new = _changes([column[ranked] for column in columns])
    number = np.empty(len(heads), np.int32)
    number[order] = np.cumsum(is_new, dtype=np.int32) - 1
    return np.repeat(number, np.diff(np.append(heads, count))), ranked[is_new]


def _changes(columns: Any) -> NDArray[np.bool_]:
    """A mask of the rows that differ from the one before them; the first does."""
    change = np.ones(len(columns[0]), np.bool_)
    change[1:] = False
    for column in columns:
        change[1:] |= column[1:] != column[:-1]
    return change
