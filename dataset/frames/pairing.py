"""Pair the messages of a log with its vehicle states."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from dataset.frames.distinct_rows import number_distinct
from dataset.frames.drivers import Commands
from recorder import Pictures
from recorder.rows.row_quality import States


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
