"""The columns of the frames that come from other topics than the vehicle state's, as the registry has them."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from dataset.frames.pairing import Moments, paired_rows
from recorder import Log
from recorder.rows.row_quality import States
from recorder.topics import TOPICS, VEHICLE

_TOPICS: Final = tuple(topic for topic in TOPICS.values() if topic.columns and topic.name != VEHICLE)

TOPIC_COLUMNS: Final = tuple(column.name for topic in _TOPICS for column in topic.columns)


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
