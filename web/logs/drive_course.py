"""The course of a drive by rows: who drove, predicted and sent steering, the car's place; and the road."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from recorder import Log, topics
from recorder.teleop.frame_state import road_named
from web.processes.predictions import Values, at_rows

COLUMNS: Final = ("driver", "network", "sent", "expert", "x_m", "y_m")
_COMMAND: Final = ("driver", "predicted_steering", "steering", "expert_steering")
_PLACE: Final = ("pose.position.x", "pose.position.y")
_FARTHEST_M: Final = 1e6  # a place farther away is invalid


def is_driven(topics_of_log: Iterable[str]) -> bool:
    """Whether a log with these topics has a course: commands or poses."""
    return not {topics.PILOT_COMMAND, topics.POSE}.isdisjoint(topics_of_log)


def course_columns(log: Log, rows: NDArray[np.int64]) -> Values:
    """Return `COLUMNS` for the rows (N,) of a log: (6, N); NaN for missing values.

    The driver is a number of `PilotCommand.Driver`. Steering is -1 (left) to 1 (right); the network's is not
    clamped. Places are metres east and north. Raises LogError for a damaged log.
    """
    columns = np.full((len(COLUMNS), len(rows)), np.nan)
    for topic, fields, at in ((topics.PILOT_COMMAND, _COMMAND, 0), (topics.POSE, _PLACE, len(_COMMAND))):
        if log.counts.get(topic):
            table = log.numbers(topic, fields)
            values = np.stack([table[name].to_numpy() for name in fields])
            columns[at : at + len(fields)] = at_rows(table["row"].to_numpy(), values, rows)
    is_place = (np.abs(columns[4:]) < _FARTHEST_M).all(axis=0)  # False for NaN
    columns[4:, ~is_place] = np.nan
    return columns


def road_of(log: Log) -> dict[str, Any] | None:
    """The edges of the built-in road that a log names (`road_named`); None if it names none."""
    name = log.metadata.get("track", "")
    is_placed = name and log.counts.get(topics.POSE)
    return road_named(name, log.metadata.get("track_fingerprint", "")) if is_placed else None
