"""Which messages of a log belong to which of its vehicle states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from dataset.index.drivers import Commands
from recorder import Pictures
from recorder.log.row_quality import States


@dataclass(frozen=True)
class Moments:
    """Row number and log time of messages; arrays of one length."""

    sequence: NDArray[np.int64]
    log_time_ns: NDArray[np.int64]


def paired_rows(
    messages: Pictures | Commands | Moments, states: States
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs messages with vehicle states by row number and log time: (positions of states, of messages)."""
    count = len(states.row)
    row = np.concatenate([states.row, messages.sequence])
    time_ns = np.concatenate([states.time_ns, messages.log_time_ns])
    order = np.lexsort((time_ns, row))  # stable: of what is alike, states come before messages
    is_new = np.ones(len(order), np.bool_)
    is_new[1:] = (np.diff(row[order]) != 0) | (np.diff(time_ns[order]) != 0)
    first = order[np.maximum.accumulate(np.where(is_new, np.arange(len(order)), 0))]
    state = np.empty(len(order), np.int64)
    state[order] = first  # the first of those alike; a message's is a state, if there is one
    state = state[count:]
    found = np.flatnonzero(state < count)
    return state[found], found


def moments(frames: pa.Table) -> NDArray[np.void]:
    """Row and log time of each frame (N,): what tells one moment of a log from another."""
    found = np.empty(len(frames), [("row", np.int64), ("log_time_ns", np.int64)])
    for name in ("row", "log_time_ns"):
        found[name] = frames[name].to_numpy()
    return found
