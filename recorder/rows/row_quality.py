"""Flags for odd rows of a log, and the drives that pauses separate, from its vehicle states alone.

Published recordings set the thresholds: people at keyboards hold an exact 0 for up to 14 s of driving, and any
other exact value for at most 2 s. The simulator writes at least five rows a second.
"""

from __future__ import annotations

import json
import math
from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from common.car import SPEED_RANGE_MPH
from common.stretches import runs, stretches, stretches_within
from recorder.rows.crashes import crashed_rows, manoeuvring_rows
from recorder.rows.devices import RowDevice, most_used
from recorder.rows.driving_backwards import driven_backwards

if TYPE_CHECKING:
    import pyarrow as pa

    from recorder.bc_pb2 import VehicleState


GAP_S: Final = 1.0
APART_S: Final = 1000.0  # more than any time over which rows are compared
STANDING_MPH: Final = 0.5
STUCK_S: Final = 3.0
STUCK_AT_ZERO_S: Final = 30.0
MAX_STRETCHES: Final = 100  # listed in a log's summary of its rows; counts include all

PARKED_S: Final = 5.0  # in recordings of people, an ordinary start waits for 1.6 to 3.2 s

RowFlag = Literal[
    "gap", "out_of_range", "standing_still", "stuck_steering", "crash", "backwards", "manoeuvring", "parked"
]
ROW_FLAGS: Final[tuple[RowFlag, ...]] = get_args(RowFlag)
NOT_LEARNT: Final[tuple[RowFlag, ...]] = ("crash", "backwards", "manoeuvring", "parked")
"""Rows with one of these are left out of training by default. For rows with several, the first counts."""

Values = NDArray[np.float64]
_NEAR_STEP: Final = 0.6  # share of the median
_UNEVEN_STEPS: Final = 0.1  # share of the median


@dataclass(frozen=True)
class States:
    """The vehicle states of a log in its order; arrays of one length."""

    row: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    steering: Values
    throttle: Values
    brake: Values
    speed_mph: Values  # NaN if unknown
    beyond_m: Values | None = None  # from the road's edge (`recorder.log.road_places`); None: unknown road
    heading_rad: Values | None = None  # counter-clockwise, NaN without a pose; None: no poses

    @classmethod
    def of(cls, vehicle: pa.Table) -> States:
        """The states in a table of `Log.vehicle`."""
        return cls(*(vehicle[name].to_numpy() for name in vehicle.column_names))

    def part(self, chosen: NDArray[Any] | Sequence[int]) -> States:
        """Some of the rows, by a mask or by their positions."""
        columns: Any = [None if column is None else column[chosen] for column in vars(self).values()]
        return States(*columns)


@dataclass(frozen=True)
class Motion:
    """How the car of a log moves; arrays (N,), a number a row."""

    speed_mph: Values  # without sign, NaN if unknown
    standing: NDArray[np.bool_]
    usual_mph: float  # from `usual_speed_mph`
    time_s: Values  # from `elapsed_s`
    drive: NDArray[np.int64]  # from `drive_numbers`


class StatesWritten:
    """The states of a log while it is written: 48 bytes a row."""

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
        """The device of most rows."""
        return most_used(self._devices)

    def __len__(self) -> int:
        return len(self._numbers) // 2

    def states(self) -> States:
        numbers = np.array(self._numbers, np.int64).reshape(-1, 2)
        values = np.array(self._values, np.float64).reshape(-1, 4)
        return States(numbers[:, 0], numbers[:, 1], *values.T)


def summary(states: States) -> dict[str, str]:
    """The summary of its rows that a log keeps at its end: drives, rows by flag, and the first flagged stretches.

    Stretches are JSON: [flag, first row, last row, begin and end in seconds from the log's first row]. A gap
    begins at the row before it.
    """
    flags = row_flags(states)
    flagged = sorted((first, last, flag) for flag, mask in flags.items() for first, last in stretches(mask))
    since_s = (states.time_ns - states.time_ns[:1]) / 1e9
    listed = [
        [flag, *states.row[[first, last]].tolist(), *since_s[[first - (flag == "gap"), last]].tolist()]
        for first, last, flag in flagged[:MAX_STRETCHES]
    ]
    return {
        "rows": str(len(states.row)),
        "drives": str(int(drive_numbers(states.time_ns)[-1]) + 1 if len(states.row) else 0),
        "driven_s": f"{driven_s(states.time_ns):.3f}",
        **{flag: str(int(mask.sum())) for flag, mask in flags.items()},
        "stretches": json.dumps(listed),
    }


def drive_numbers(time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number of each row's drive (N,), from 0. A new drive begins after a gap, or where time goes
    backwards."""
    step_ns = np.diff(time_ns)
    return np.concatenate([[0], np.cumsum((step_ns > GAP_S * 1e9) | (step_ns < 0))])[: len(time_ns)]


def elapsed_s(time_ns: NDArray[np.int64]) -> Values:
    """The rows' times (N,) in seconds, ascending. Drives are `APART_S` apart, however long the real pause was."""
    same = np.diff(drive_numbers(time_ns)) == 0
    step_s = np.where(same, np.diff(time_ns) / 1e9, APART_S)
    return np.concatenate([[0.0], np.cumsum(step_s)])[: len(time_ns)]


def driven_s(time_ns: NDArray[np.int64]) -> float:
    """The sum of the drives' times, without the pauses between them."""
    return float(np.diff(time_ns)[np.diff(drive_numbers(time_ns)) == 0].sum()) / 1e9


def row_flags(states: States) -> dict[RowFlag, NDArray[np.bool_]]:
    """The rows (N,) of each flag.

    - `gap`: the first row after a gap in time
    - `out_of_range`: steering outside -1..1, pedals outside 0..1, either NaN, or speed outside `SPEED_RANGE_MPH`
    - `standing_still`
    - `stuck_steering`: exactly the same steering for long while the car moves
    - `crash`: the car stands at an obstacle, or manoeuvres to get away from it
    - `backwards`
    - `manoeuvring`: the second before an impact, and the way out of a crash or of driving backwards
    - `parked`: the car stands for long, in a session in which it drives
    """
    drive, time_s = drive_numbers(states.time_ns), elapsed_s(states.time_ns)
    standing = np.abs(states.speed_mph) < STANDING_MPH  # False for an unknown speed
    speed_mph = np.where(np.isfinite(states.speed_mph), np.clip(states.speed_mph, *SPEED_RANGE_MPH), np.nan)
    backwards = driven_backwards(speed_mph, states.throttle, states.brake, time_s, drive).sure
    motion = Motion(np.abs(speed_mph), standing, usual_speed_mph(states), time_s, drive)
    crashed = crashed_rows(motion, states.steering)
    manoeuvring = manoeuvring_rows(motion, states.steering, crashed, backwards)
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
        "crash": crashed,
        "backwards": backwards,
        "manoeuvring": manoeuvring,
        "parked": _parked(motion) & np.isfinite(motion.usual_mph),
    }


def usual_speed_mph(states: States) -> float:
    """The median speed of the rows in which the car moves; NaN if it never moves."""
    speed_mph = np.abs(np.where(np.isfinite(states.speed_mph), np.clip(states.speed_mph, *SPEED_RANGE_MPH), 0.0))
    moving = speed_mph[speed_mph >= STANDING_MPH]
    return float(np.median(moving)) if len(moving) else math.nan


def _parked(motion: Motion) -> NDArray[np.bool_]:
    parked = np.zeros(len(motion.drive), np.bool_)
    for first, last in stretches_within(motion.standing, motion.drive):
        parked[first : last + 1] = motion.time_s[last] - motion.time_s[first] >= PARKED_S
    return parked


def _stuck(states: States, drive: NDArray[np.int64], standing: NDArray[np.bool_]) -> NDArray[np.bool_]:
    changes = (states.steering[1:] != states.steering[:-1]) | (np.diff(drive) != 0) | (np.diff(standing) != 0)
    first, last = runs(changes, len(drive))
    limit_s = np.where(states.steering[first] == 0, STUCK_AT_ZERO_S, STUCK_S)
    held_ns = states.time_ns[last] - states.time_ns[first]
    return np.repeat(~standing[first] & (held_ns >= limit_s * 1e9), last - first + 1)


def usual_step(steps: NDArray[Any]) -> float:
    """The median of steps (N,), N > 0, all above 0. If steps alternate (0.04 and 0.06 s at a person's 20 rows a
    second), the mean of the steps near the median."""
    median = float(np.median(steps))
    near = steps[np.abs(steps - median) <= _NEAR_STEP * median]
    if not len(near):  # the median of an even number of steps may be far from all of them
        return median
    mean = float(near.mean())
    return mean if abs(mean - median) > _UNEVEN_STEPS * median else median
