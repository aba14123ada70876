"""Rows in which a car creeps, or coasts to a halt: a driver who is about to do something else than drive."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.stretches import stretches_within

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

CREEP_SPEED_SHARE: Final = 0.15  # of the usual speed: nobody takes a bend at that
CREEP_S: Final = 2.0  # of moving; a start from a stand is over in one
COAST_S: Final = 1.5
COAST_SPEED_SHARE: Final = 1 / 3
PEDAL: Final = 0.05
_ROUNDING_MPH: Final = 0.2


def creeping_rows(
    speed_mph: Values, standing: Mask, usual_mph: float, time_s: Values, drive: NDArray[np.int64]
) -> Mask:
    """The rows (N,) in which the car moves far below its usual speed for long, with its stops in between.
    `speed_mph` is without a sign, NaN where it is unknown; `time_s` is that of `elapsed_s`."""
    creeping = np.zeros(len(drive), np.bool_)
    step_s = np.minimum(np.diff(time_s, append=time_s[-1:]), 1.0)
    for first, last in stretches_within(speed_mph < CREEP_SPEED_SHARE * usual_mph, drive):
        moves = ~standing[first : last + 1]
        if step_s[first : last + 1][moves].sum() >= CREEP_S:
            at = first + np.flatnonzero(moves)
            creeping[at[0] : at[-1] + 1] = True
    return creeping


def coasting_rows(
    speed_mph: Values,
    throttle: Values,
    brake: Values,
    standing: Mask,
    usual_mph: float,
    time_s: Values,
    drive: NDArray[np.int64],
) -> Mask:
    """The rows (N,) in which the car rolls to a halt without throttle and brake; none where no throttle was
    recorded. Arguments are those of `creeping_rows`."""
    coasting = np.zeros(len(drive), np.bool_)
    is_pushed = throttle > PEDAL
    if not is_pushed.any():
        return coasting
    rises = np.diff(speed_mph, prepend=speed_mph[:1]) > _ROUNDING_MPH
    rolls = ~is_pushed & ~(brake > PEDAL) & ~rises & np.isfinite(speed_mph)
    for first, last in stretches_within(rolls, drive):
        halt = np.flatnonzero(standing[first : last + 1])
        if not len(halt) or speed_mph[first] < COAST_SPEED_SHARE * usual_mph:
            continue
        stop = first + int(halt[0])
        coasting[first : stop + 1] = time_s[stop] - time_s[first] >= COAST_S
    return coasting
