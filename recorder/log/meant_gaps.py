"""Gaps in time that events of the log explain, so that a check does not take them for lost rows: nothing was
recorded on purpose, as of a car that is pushed off its line (an event at the first row behind such a gap has its
length), or a human drove, and the simulator sent nothing.
"""

from __future__ import annotations

import json
import re
from array import array
from collections import defaultdict
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.untrusted_json import json_as
from recorder.rows.row_quality import GAP_S, States, row_flags

MEANT_GAPS: Final = "meant_gaps"
HUMAN_DRIVES: Final = "manual: a human drives"
PILOT_DRIVES_AGAIN: Final = "manual: the pilot drives again"
"""At the first row behind a stretch that a human drove; logs of earlier versions have it right before that row."""
HUMAN_HAS_STOPPED: Final = "manual: telemetry comes again"
"""The same in a recording."""
DISCONNECTED: Final = "disconnected: "
"""The beginning of an event, which ends such a stretch too."""

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
        self._human_since_ns: int | None = None
        self._human_ns = array("q")  # begin and end of each stretch that a human drove, one after the other

    def add(self, time_ns: int, event: str) -> None:
        """An event of the log; to be called in the order of the log."""
        if event == HUMAN_DRIVES:
            self._human_since_ns = time_ns if self._human_since_ns is None else self._human_since_ns
        elif event in (PILOT_DRIVES_AGAIN, HUMAN_HAS_STOPPED) or event.startswith(DISCONNECTED):
            if self._human_since_ns is not None:
                self._human_ns.extend((self._human_since_ns, time_ns))
            self._human_since_ns = None
        elif found := _EVENT.match(event):
            self._seconds[time_ns] += float(found[1])

    def gaps(self, states: States) -> NDArray[np.bool_]:
        """The rows (N,) behind a gap that was meant.

        One that is longer than its events declare, by more than a gap takes, has lost rows as well.
        """
        step_s = np.diff(states.time_ns, prepend=states.time_ns[:1]) / 1e9
        declared_s = np.array([self._seconds.get(time_ns, 0.0) for time_ns in states.time_ns.tolist()], np.float64)
        declared_s += self._human_s(states.time_ns)
        meant: NDArray[np.bool_] = (step_s > 0) & (declared_s > 0) & (step_s - declared_s <= GAP_S)
        return row_flags(states)["gap"] & meant if meant.any() else meant

    def _human_s(self, time_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """The seconds before each row (N,), since the row before it, that a human drove."""
        begin_ns, end_ns = np.array(self._human_ns, np.int64).reshape(-1, 2).T
        row = np.searchsorted(time_ns, end_ns)  # the first one that is not before the end
        is_between = (row > 0) & (row < len(time_ns))
        row, begin_ns, end_ns = row[is_between], begin_ns[is_between], end_ns[is_between]
        is_between = (time_ns[row - 1] <= begin_ns) & (begin_ns <= end_ns) & (end_ns <= time_ns[row])
        seconds = np.zeros(len(time_ns))
        np.add.at(seconds, row[is_between], (end_ns - begin_ns)[is_between] / 1e9)
        return seconds

    def summary(self, states: States) -> dict[str, str]:
        """The log's note of them, beside `row_quality.summary`; empty without any."""
        rows: list[int] = states.row[self.gaps(states)].tolist()
        return {MEANT_GAPS: json.dumps(rows)} if rows else {}


def meant_rows(quality: Mapping[str, str]) -> list[int]:
    """The rows behind gaps that were meant, from a log's `bc.quality`; somebody else may have written it."""
    return json_as(quality.get(MEANT_GAPS, "[]"), list[int]) or []
