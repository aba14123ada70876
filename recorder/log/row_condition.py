"""Rows chosen by a condition on their numbers: "speed_mph < 2 and throttle == 0"."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.errors import UsageError
from recorder.log.row_quality import States

COLUMNS: Final = ("row", "time_s", "steering", "throttle", "brake", "speed_mph")
_COMPARED: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
}
_PART: Final = re.compile(r"\s*(\w+)\s*(<=|>=|==|!=|<|>)\s*(-?\d{1,15}(?:\.\d{1,15})?)\s*")


def rows_where(states: States, condition: str) -> NDArray[np.bool_]:
    """The rows (N,) for which comparisons of `COLUMNS` with numbers, joined by `and`, all hold.

    `time_s` counts from the first row. Raises UsageError for anything else.
    """
    chosen = np.ones(len(states.row), np.bool_)
    for part in condition.split(" and "):
        match = _PART.fullmatch(part)
        if match is None or match[1] not in COLUMNS:
            raise UsageError(
                f"--where {condition!r}: comparisons of {', '.join(COLUMNS)} with numbers were expected,"
                f' such as "speed_mph < 2 and throttle == 0"'
            )
        since_s = (states.time_ns - states.time_ns[:1]) / 1e9
        values = since_s if match[1] == "time_s" else getattr(states, match[1])
        chosen &= _COMPARED[match[2]](values, float(match[3]))
    return chosen
