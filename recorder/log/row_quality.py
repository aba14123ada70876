"""Flags for odd rows of a log, and where a pause begins a new drive, from its vehicle states alone.

Thresholds were set on published recordings: people with keyboards hold an exact 0 for up to 14 s of driving, and
any other exact value for at most 2 s; the simulator writes at least five rows a second.
"""

from __future__ import annotations

import json
from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from common.stretches import stretches
from recorder.log.backwards import drives_backwards
from recorder.log.devices import RowDevice, most_used

if TYPE_CHECKING:
    import pyarrow as pa

    from recorder.bc_pb2 import VehicleState

GAP_S: Final = 1.0
APART_S: Final = 1000.0  # more than any time over which rows are compared
STANDING_MPH: Final = 0.5
SPEED_RANGE_MPH: Final = (-30.0, 300.0)
"""No car reverses faster, and no simulator's that anybody drives goes faster; the real simulator's reaches 30."""
CRASH_SPEED_SHARE: Final = 1 / 3
"""Of the speed that is usual in the session, the median: bends are taken at more."""
CRASH_S: Final = 0.5  # at least; a single row of no speed is a fault of the source
IMPACT_MPH: Final = 9.0
IMPACT_S: Final = 0.2
"""So much speed lost in so short a time is twice what tyres can brake (1 g, 22 mph a second): an impact."""
IMPACT_LEADS_S: Final = 0.5  # a car bounces, and rolls out, before it is slow
CRASH_LOCK: Final = 0.5
CRASH_LOCK_SHARE: Final = 0.25
"""A wheel at half lock or more in so many of its rows is manoeuvring; to stop and start, it is straight."""
STUCK_S: Final = 3.0
STUCK_AT_ZERO_S: Final = 30.0
MOST_STRETCHES: Final = 100  # listed in a log's summary of its rows; the counts are of all

RowFlag = Literal["gap", "out_of_range", "standing_still", "stuck_steering", "crash", "backwards"]
ROW_FLAGS: Final[tuple[RowFlag, ...]] = get_args(RowFlag)
NOT_LEARNT: Final[tuple[RowFlag, ...]] = ("crash", "backwards")
"""The steering of these rows is no answer to the road: the default recipe leaves them out of training."""
SURE_FLAGS: Final[frozenset[RowFlag]] = frozenset((*NOT_LEARNT, "out_of_range"))
"""Nobody should learn from these rows."""

Values = NDArray[np.float64]


@dataclass(frozen=True)
class States:
    """The vehicle states of a log in its order; arrays of one length."""

    row: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    steering: Values
    throttle: Values
    brake: Values
    speed_mph: Values  # NaN where it is not known

    @classmethod
    def of(cls, vehicle: pa.Table) -> States:
        """The states in a table of `Log.vehicle`."""
        return cls(*(vehicle[name].to_numpy() for name in vehicle.column_names))

    def part(self, chosen: NDArray[Any] | Sequence[int]) -> States:
        """Some of the rows, by a mask or by their positions."""
        return States(*(column[chosen] for column in vars(self).values()))


class StatesWritten:
    """The states of a log that is being written: 48 bytes a row."""

    def __init__(self) -> None:
        self._devices = Counter[int]()
        self._numbers = array("q")
        self._values = array("d")

    def add(self, row: int, time_ns: int, state: VehicleState) -> None:
        self._numbers.extend((row, time_ns))
        self._values.extend((state.steering, state.throttle, state.brake, state.speed_mph))
        self._devices[state.device] += 1

    @property
    def device(self) -> RowDevice:
        """The device that most rows were steered with."""
        return most_used(self._devices)

    def __len__(self) -> int:
        return len(self._numbers) // 2

    def states(self) -> States:
        numbers = np.array(self._numbers, np.int64).reshape(-1, 2)
        values = np.array(self._values, np.float64).reshape(-1, 4)
        return States(numbers[:, 0], numbers[:, 1], *values.T)


def summary(states: States) -> dict[str, str]:
    """A log's summary of its own rows, so that nobody has to read it all: drives, how many rows each flag holds
    for, and the first stretches of them as JSON: [flag, first row, last row, begin and end in seconds from the
    log's first row]; a gap begins at the row before it."""
    flags = row_flags(states)
    found = sorted((first, last, flag) for flag, mask in flags.items() for first, last in stretches(mask))
    since_s = (states.time_ns - states.time_ns[:1]) / 1e9
    listed = [
        [
            flag,
            int(states.row[first]),
            int(states.row[last]),
            float(since_s[first - (flag == "gap")]),
            float(since_s[last]),
        ]
        for first, last, flag in found
    ]
    return {
        "rows": str(len(states.row)),
        "drives": str(int(drive_numbers(states.time_ns)[-1]) + 1 if len(states.row) else 0),
        "driven_s": f"{driven_s(states.time_ns):.3f}",
        **{flag: str(int(mask.sum())) for flag, mask in flags.items()},
        "stretches": json.dumps(listed[:MOST_STRETCHES]),
    }


def drive_numbers(time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers the drives of a session from 0: a new one begins after a gap, or where time goes backwards."""
    step_ns = np.diff(time_ns)
    return np.concatenate([[0], np.cumsum((step_ns > GAP_S * 1e9) | (step_ns < 0))])[: len(time_ns)]


def elapsed_s(time_ns: NDArray[np.int64]) -> Values:
    """The rows' times (N,) in seconds, in ascending order; drives lie `APART_S` from each other, whatever lay
    between them."""
    same = np.diff(drive_numbers(time_ns)) == 0
    step_s = np.where(same, np.diff(time_ns) / 1e9, APART_S)
    return np.concatenate([[0.0], np.cumsum(step_s)])[: len(time_ns)]


def driven_s(time_ns: NDArray[np.int64]) -> float:
    """The time that was driven: that of all drives, without what lies between them."""
    return float(np.diff(time_ns)[np.diff(drive_numbers(time_ns)) == 0].sum()) / 1e9


def row_flags(states: States) -> dict[RowFlag, NDArray[np.bool_]]:
    """For each flag the rows (N,) that it holds for.

    `gap`: the first row after a gap in time; `out_of_range`: steering beyond -1..1, pedals beyond 0..1, or no
    number, or a speed beyond `SPEED_RANGE_MPH`; `standing_still`; `stuck_steering`: the very same steering for
    long while the car moves; `crash`: the car stands at an obstacle, or manoeuvres to get away from it;
    `backwards`: it rolls backwards.
    """
    drive = drive_numbers(states.time_ns)
    standing = states.speed_mph < STANDING_MPH  # False for an unknown speed
    in_range = np.abs(states.steering) <= 1  # False for NaN too
    for pedal in (states.throttle, states.brake):
        in_range &= (pedal >= 0) & (pedal <= 1)
    slowest_mph, fastest_mph = SPEED_RANGE_MPH
    in_range &= ~((states.speed_mph < slowest_mph) | (states.speed_mph > fastest_mph))  # unknown, NaN, is allowed
    return {
        "gap": np.diff(drive, prepend=drive[:1]) > 0,
        "out_of_range": ~in_range,
        "standing_still": standing,
        "stuck_steering": _stuck(states, drive, standing),
        "crash": _crashed(states, drive, standing),
        "backwards": drives_backwards(drive, states.throttle, states.brake, states.speed_mph),
    }


def _stuck(states: States, drive: NDArray[np.int64], standing: NDArray[np.bool_]) -> NDArray[np.bool_]:
    changes = (states.steering[1:] != states.steering[:-1]) | (np.diff(drive) != 0) | (np.diff(standing) != 0)
    edges = np.flatnonzero(changes)
    first = np.concatenate([[0], edges + 1])[: len(drive)]
    last = np.append(edges, len(drive) - 1)[: len(first)]
    limit_s = np.where(states.steering[first] == 0, STUCK_AT_ZERO_S, STUCK_S)
    held_ns = states.time_ns[last] - states.time_ns[first]
    return np.repeat(~standing[first] & (held_ns >= limit_s * 1e9), last - first + 1)


def _crashed(states: States, drive: NDArray[np.int64], standing: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Stretches far below the usual speed in which the car stands, and which an impact began or in which the wheel
    is turned far for long. One that begins a drive is a start, whatever the wheel does: nothing was driven into.

    A session that is slow throughout has a slow usual speed, and in a hairpin nobody stands.
    """
    crashed = np.zeros(len(drive), np.bool_)
    speed_mph = np.where(np.isfinite(states.speed_mph), np.clip(states.speed_mph, *SPEED_RANGE_MPH), np.nan)
    moving = speed_mph[speed_mph >= STANDING_MPH]
    if not len(moving) or not standing.any():
        return crashed
    time_s = elapsed_s(states.time_ns)
    is_hit = np.interp(time_s - IMPACT_S, time_s, speed_mph) - speed_mph >= IMPACT_MPH
    turned = np.abs(states.steering) >= CRASH_LOCK
    slow = speed_mph < CRASH_SPEED_SHARE * np.median(moving)
    for first, last in _within_drives(slow, drive):
        starts_drive = first == 0 or drive[first - 1] != drive[first]
        is_brief = time_s[last] - time_s[first] < CRASH_S
        if starts_drive or is_brief or not standing[first : last + 1].any():
            continue
        before = np.searchsorted(time_s, time_s[first] - IMPACT_LEADS_S)  # no earlier drive is so near
        if is_hit[before : last + 1].any() or turned[first : last + 1].mean() >= CRASH_LOCK_SHARE:
            crashed[first : last + 1] = True
    return crashed


def _within_drives(mask: NDArray[np.bool_], drive: NDArray[np.int64]) -> list[tuple[int, int]]:
    """First and last row of every run of True in a mask (N,); where a drive begins, so does a run."""
    starts = np.flatnonzero(np.diff(drive)) + 1
    return [
        (first + at, last + at)
        for at, part in zip([0, *starts.tolist()], np.split(mask, starts), strict=True)
        for first, last in stretches(part)
    ]
