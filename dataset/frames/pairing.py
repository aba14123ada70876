"""Pairing of a log's messages with its vehicle states, and the columns of frames that other topics give by it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from dataset.frames.distinct_rows import number_distinct
from dataset.frames.drivers import Commands
from recorder import Log, Pictures
from recorder.rows.row_quality import States
from recorder.topics import TOPICS, VEHICLE

_TOPICS: Final = tuple(topic for topic in TOPICS.values() if topic.columns and topic.name != VEHICLE)
TOPIC_COLUMNS: Final = tuple(column.name for topic in _TOPICS for column in topic.columns)


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
    number, first = number_distinct(
        np.concatenate([states.time_ns, messages.log_time_ns]), np.concatenate([states.row, messages.sequence])
    )
    state = first[number[count:]]  # the first of those alike: a state, if there is one
    paired = np.flatnonzero(state < count)
    return state[paired], paired


def moments(frames: pa.Table) -> NDArray[np.void]:
    """Row and log time of each frame (N,), which identify a moment of a log."""
    identities = np.empty(len(frames), [("row", np.int64), ("log_time_ns", np.int64)])
    for name in ("row", "log_time_ns"):
        identities[name] = frames[name].to_numpy()
    return identities


def topic_columns(log: Log, states: States) -> dict[str, NDArray[np.float64]]:
    """`TOPIC_COLUMNS` at the vehicle states of a log (N,), by name; NaN where nothing was recorded.

    Raises LogError for a damaged log.
    """
    columns = {name: np.full(len(states.row), np.nan) for name in TOPIC_COLUMNS}
    for topic in _TOPICS:
        if log.schemas.get(topic.name) == topic.message.name:
            table = log.table(topic.name)
            moments = Moments(table["row"].to_numpy(), table["log_time_ns"].to_numpy())
            state, message = paired_rows(moments, states)
            for column in topic.columns:
                columns[column.name][state] = table[column.name].to_numpy()[message]
    return columns
