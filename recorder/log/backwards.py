"""Where a car drives backwards, by its numbers alone."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

REVERSING_MPH: Final = -0.5
"""The speed of a source that gives it a sign."""
SLOW_MPH: Final = 5.0
"""With the brake held, the real simulator reverses from this speed down, and brakes above it."""
RISE_MPH: Final = 1.5
"""So much faster a car gets with the brake held: a row late is less, and no hill is braked on."""
STAND_MPH: Final = 1.5
"""A car that changes its direction is slower than that in one of its rows."""
_PEDAL: Final = 0.05


def drives_backwards(
    drive: NDArray[np.int64], throttle: Values, brake: Values, speed_mph: Values
) -> NDArray[np.bool_]:
    """The rows (N,) of a car that rolls backwards; `drive` numbers the drives, an unknown speed is NaN.

    Where the speed has a sign, it says so. Elsewhere a car goes backwards from where it gets faster with the brake
    held, or a throttle below 0, until it stands or the throttle makes it faster again.
    """
    backwards = speed_mph < REVERSING_MPH
    if backwards.any():
        return backwards
    is_braked = ((brake > _PEDAL) | (throttle < -_PEDAL)) & (throttle <= _PEDAL) & np.isfinite(speed_mph)
    edges = np.flatnonzero(np.diff(is_braked) | (np.diff(drive) != 0)) + 1
    for first, end in zip([0, *edges], [*edges, len(drive)], strict=True):
        if not end or not is_braked[first]:
            continue
        turn = first + int(speed_mph[first:end].argmin())
        if speed_mph[turn] > SLOW_MPH or speed_mph[turn:end].max() - speed_mph[turn] < RISE_MPH:
            continue
        last = end - 1
        while last + 1 < len(drive) and drive[last + 1] == drive[first] and not _turns(throttle, speed_mph, last):
            last += 1
        backwards[turn : last + 1] = True
    return backwards


def _turns(throttle: Values, speed_mph: Values, row: int) -> bool:
    """Whether a car that rolled backwards has come to a stand by that row."""
    later_mph = speed_mph[row + 1]
    is_faster = later_mph > speed_mph[row] and throttle[row + 1] > _PEDAL
    return bool(not np.isfinite(later_mph) or speed_mph[row] < STAND_MPH or is_faster)
