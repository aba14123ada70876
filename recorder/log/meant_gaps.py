"""Gaps in time that a recorder left on purpose, such as those of a car that is pushed off its line: an event at
the first row behind each has the time that was not recorded, so that a check does not take them for lost rows."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from recorder.log.row_quality import GAP_S, States, row_flags

MEANT_GAPS: Final = "meant_gaps"
_EVENT: Final = re.compile(r"not recorded: ([0-9]{1,6}(?:\.[0-9]{1,3})?) s, ")


def not_recorded(seconds: float, why: str) -> str:
    """The text of the event: so many seconds lie between two rows, beside those that lie between any two."""
    return f"not recorded: {seconds:.3f} s, {why}"


def is_not_recorded(event: str) -> bool:
    """True for such a text."""
    return bool(_EVENT.match(event))


class NotRecorded:
    """The times that were not recorded on purpose, from the events of a log."""

    def __init__(self) -> None:
        self._seconds = defaultdict[int, float](float)  # by log time

    def add(self, time_ns: int, event: str) -> None:
        if found := _EVENT.match(event):
            self._seconds[time_ns] += float(found[1])

    def gaps(self, states: States) -> NDArray[np.bool_]:
        """The rows (N,) behind a gap that was meant.

        One that is longer than its event declares, by more than a gap takes, has lost rows as well.
        """
        step_s = np.diff(states.time_ns, prepend=states.time_ns[:1]) / 1e9
        declared_s = np.array([self._seconds.get(time_ns, 0.0) for time_ns in states.time_ns.tolist()], np.float64)
        meant: NDArray[np.bool_] = (step_s > 0) & (declared_s > 0) & (step_s - declared_s <= GAP_S)
        return row_flags(states)["gap"] & meant if meant.any() else meant

    def summary(self, states: States) -> dict[str, str]:
        """The log's note of them, beside `row_quality.summary`; empty without any."""
        rows: list[int] = states.row[self.gaps(states)].tolist()
        return {MEANT_GAPS: json.dumps(rows)} if rows else {}


def meant_rows(quality: Mapping[str, str]) -> list[int]:
    """The rows behind gaps that were meant, from a log's `bc.quality`; somebody else may have written it."""
    try:
        return msgspec.json.decode(quality.get(MEANT_GAPS, "[]"), type=list[int])
    except msgspec.MsgspecError:
        return []
