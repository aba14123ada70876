"""Number or group equal rows: samples of one picture, frames of one moment or session; pair the messages of a log
with its vehicle states."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from dataset.frames.drivers import Commands
from recorder import Pictures
from recorder.rows.row_quality import States


def number_distinct(*columns: NDArray[Any]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Number the distinct rows of some columns (N,), sorted by the last column first.

    Returns the number of each row (N,), and the first row of each number. The samples of one picture are mostly
    neighbours, so only a few of the rows have to be sorted.
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
    """A mask of the rows that differ from the previous row; the first row is marked."""
    change = np.ones(len(columns[0]), np.bool_)
    change[1:] = False
    for column in columns:
        change[1:] |= column[1:] != column[:-1]
    return change


def by_session(rows: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    """Yield the name and the rows of each session, sorted by name; the rows keep their order."""
    session = rows["session"].combine_chunks().dictionary_encode()
    number, names = session.indices.to_numpy(), session.dictionary.to_pylist()
    ends = np.cumsum(np.bincount(number, minlength=len(names)))
    parts = np.split(np.argsort(number, kind="stable"), ends[:-1])
    return ((names[at], rows.take(pa.array(parts[at]))) for at in sorted(range(len(names)), key=names.__getitem__))


def paired_rows(messages: Pictures | Commands, states: States) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pair messages with vehicle states by row number and log time. Returns the positions (N,) of the states, and
    of the messages."""
    count = len(states.row)
    number, first = number_distinct(
        np.concatenate([states.time_ns, messages.log_time_ns]), np.concatenate([states.row, messages.sequence])
    )
    state = first[number[count:]]  # the first of the equal rows, which is a state if a state is among them
    paired = np.flatnonzero(state < count)
    return state[paired], paired


def moments(frames: pa.Table) -> NDArray[np.void]:
    """The row and log time of each frame (N,): together they identify a moment in a log."""
    identities = np.empty(len(frames), [("row", np.int64), ("log_time_ns", np.int64)])
    for name in ("row", "log_time_ns"):
        identities[name] = frames[name].to_numpy()
    return identities
