"""Gaps in time that whoever recorded meant, such as those of a car that is pushed off its line: an event at the
first row behind each tells how long was not recorded, so that a check can tell them from rows that were lost."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recorder.log.row_quality import GAP_S, States

_EVENT: Final = re.compile(r"not recorded: ([0-9]{1,6}(?:\.[0-9]{1,3})?) s, ")


def not_recorded(seconds: float, why: str) -> str:
    """The text of the event: so many seconds lie between two rows, beside those that lie between any two."""
    return f"not recorded: {seconds:.3f} s, {why}"


def seconds_told(event: str) -> float:
    """The seconds in the text of an event; 0 for another one."""
    found = _EVENT.match(event)
    return float(found[1]) if found else 0.0


def are_meant(states: States, told_s: Mapping[int, float]) -> NDArray[np.bool_]:
    """The rows (N,) before which time was let pass on purpose. `told_s`: the seconds of events, by log time.

    What is longer than its event tells, by more than a gap takes, has lost rows as well.
    """
    step_s = np.diff(states.time_ns, prepend=states.time_ns[:1]) / 1e9
    told = np.array([told_s.get(time_ns, 0.0) for time_ns in states.time_ns.tolist()], np.float64)
    meant: NDArray[np.bool_] = (step_s > 0) & (told > 0) & (step_s - told <= GAP_S)
    return meant
