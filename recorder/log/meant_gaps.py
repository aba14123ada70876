"""Time that a log leaves out on purpose: a car is pushed off its line, a person pauses, or a human drives and the
simulator sends nothing.

The row after the gap has its seconds (`VehicleState.not_recorded_s`), and an event has the reason. Logs of version
0.3 and earlier only have the events.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter, defaultdict
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recorder.log.reader import Log
from recorder.rows.row_quality import GAP_S, States
from recorder.topics import EVENTS, VEHICLE

HUMAN_DRIVES: Final = "manual: a human drives"
PILOT_DRIVES_AGAIN: Final = "manual: the pilot drives again"
"""At the first row after a stretch that a human drove; in logs of earlier versions, right before that row."""
HUMAN_HAS_STOPPED: Final = "manual: telemetry comes again"  # the same in a recording
DISCONNECTED: Final = "disconnected: "  # the beginning of an event that also ends a human's stretch

MAX_S: Final = 1e6
_EARLIER_EVENT: Final = re.compile(r"not recorded: ([0-9]{1,6}(?:\.[0-9]{1,3})?) s, ")


class MeantGap(NamedTuple):
    """Time before a row that was left out on purpose, in addition to the usual time between rows."""

    seconds: float
    why: str

    def __str__(self) -> str:
        return f"not recorded: {self.seconds:.3f} s, {self.why}"


class HumanDriving:
    def __init__(self) -> None:
        self._since_ns: int | None = None
        self._driven_ns = 0

    def begin(self, time_ns: int) -> None:
        self._since_ns = time_ns if self._since_ns is None else self._since_ns

    def end(self, time_ns: int) -> None:
        if self._since_ns is not None:
            self._driven_ns += time_ns - self._since_ns
            self._since_ns = None

    def take_s(self) -> float:
        """The seconds driven since the last call."""
        driven_ns, self._driven_ns = self._driven_ns, 0
        return driven_ns / 1e9


class NotRecorded:
    def __init__(self) -> None:
        self._of_rows = dict[int, float]()  # seconds, by log time
        self._of_events = defaultdict[int, float](float)
        self._human_since_ns: int | None = None
        self._human_ns = array("q")  # begin and end of each stretch that a human drove, one after the other

    @classmethod
    def of(cls, log: Log) -> NotRecorded:
        """The times of an open log. Raises LogError for a damaged log."""
        times = cls()
        rows = log.numbers(VEHICLE, ["not_recorded_s"])
        for time_ns, seconds in zip(
            rows["log_time_ns"].to_pylist(), rows["not_recorded_s"].to_pylist(), strict=True
        ):
            times.add_row(time_ns, seconds)
        for message, event in log.decoded(EVENTS) if EVENTS in log.counts else ():
            times.add_event(message.log_time_ns, event.message)
        return times

    def add_row(self, time_ns: int, seconds: float) -> None:
        if 0 < seconds < MAX_S:  # False for NaN
            self._of_rows[time_ns] = seconds

    def add_event(self, time_ns: int, text: str) -> None:
        """Note an event, which counts in logs of earlier versions. Call it in the log's order."""
        if text == HUMAN_DRIVES:
            self._human_since_ns = time_ns if self._human_since_ns is None else self._human_since_ns
        elif text in (PILOT_DRIVES_AGAIN, HUMAN_HAS_STOPPED) or text.startswith(DISCONNECTED):
            if self._human_since_ns is not None:
                self._human_ns.extend((self._human_since_ns, time_ns))
            self._human_since_ns = None
        else:
            self._of_events[time_ns] += earlier_seconds(text)

    def seconds(self, states: States) -> NDArray[np.float64]:
        """The time left out before each row (N,), in seconds."""
        times_ns: list[int] = states.time_ns.tolist()
        of_rows = np.array([self._of_rows.get(time_ns, 0.0) for time_ns in times_ns], np.float64)
        of_events = np.array([self._of_events.get(time_ns, 0.0) for time_ns in times_ns], np.float64)
        declared: NDArray[np.float64] = np.maximum(of_rows, of_events + self._human_s(states.time_ns))
        return declared

    def gaps(self, states: States) -> NDArray[np.bool_]:
        """The rows (N,) after a gap that was meant. If a gap is longer than declared by more than `GAP_S`, rows
        were lost, too."""
        step_s = np.diff(states.time_ns, prepend=states.time_ns[:1]) / 1e9
        declared_s = self.seconds(states)
        meant: NDArray[np.bool_] = (step_s > 0) & (declared_s > 0) & (step_s - declared_s <= GAP_S)
        return states.flags["gap"] & meant if meant.any() else meant

    def _human_s(self, time_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """The seconds that a human drove between the previous row and each row (N,)."""
        begin_ns, end_ns = np.array(self._human_ns, np.int64).reshape(-1, 2).T
        row = np.searchsorted(time_ns, end_ns)  # the first row that is not before the end
        is_between = (row > 0) & (row < len(time_ns))
        row, begin_ns, end_ns = row[is_between], begin_ns[is_between], end_ns[is_between]
        is_between = (time_ns[row - 1] <= begin_ns) & (begin_ns <= end_ns) & (end_ns <= time_ns[row])
        seconds = np.zeros(len(time_ns))
        np.add.at(seconds, row[is_between], (end_ns - begin_ns)[is_between] / 1e9)
        return seconds


def earlier_seconds(event: str) -> float:
    """The seconds in the event of a `MeantGap`, for logs and exports of version 0.3 and earlier."""
    matched = _EARLIER_EVENT.match(event)
    return float(matched[1]) if matched else 0.0


MAX_OF_EACH: Final = 5  # events of each kind; more telemetries are only counted

_PREFIX: Final = "bad telemetry: "
_MORE: Final = re.compile(r" \(([0-9][0-9,]{0,25}) more\)$")


class BadTelemetry:
    """Counts unusable telemetries by kind (`TelemetryError.kind`). There are few kinds, whatever clients send."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def take(self, kind: str, reason: str) -> str | None:
        """Count a telemetry, and return its event; None after `MAX_OF_EACH` of its kind."""
        self.counts[kind] += 1
        return f"{_PREFIX}{reason}" if self.counts[kind] <= MAX_OF_EACH else None

    def remaining(self) -> list[str]:
        """The events at the end of a log, for telemetries that were only counted."""
        return [
            f"{_PREFIX}{kind} ({count - MAX_OF_EACH:,} more)"
            for kind, count in self.counts.items()
            if count > MAX_OF_EACH
        ]


def read_event(message: str) -> tuple[str, int]:
    """The kind in an event's text, and the number of telemetries that it stands for; 0 for other events."""
    if not message.startswith(_PREFIX):
        return message, 0
    reason = message.removeprefix(_PREFIX)
    more = _MORE.search(reason)
    return reason.partition(" (")[0], 1 if more is None else int(more[1].replace(",", ""))
