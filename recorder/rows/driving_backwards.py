"""Rows in which a car drives backwards, from speed and pedals alone.

Udacity's simulator records the speed without its sign. Between two stops, a car keeps its direction. If its speed
rises while the driver brakes, it drives backwards, from the previous stop to the next. If its speed rises without
any pedal, it may also roll downhill: that is never sure.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.stretches import stretches_within

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIGNED_MPH: Final = -0.5
SURELY_MPH: Final = -1.0
"""A session with a lower speed than this records signs. Every stretch backwards reaches it, noise does not."""
TURN_MPH: Final = 2.0
"""A car that changes its direction has a row slower than this. At 5 rows a second, the simulator's engine changes
the speed by 2.4 mph from row to row."""
PEDAL: Final = 0.05
FIRM_BRAKE: Final = 0.3  # the built-in mountain, 12 % steep, speeds up a car that brakes by 0.2
RISE_MPH: Final = 1.5
"""A smaller rise under braking is rounding, or a slope that pushes a car that begins to brake."""
ROLL_MPH: Final = 3.0
IMPACT_MPH_PER_S: Final = 25.0
"""Tyres can brake by 22 mph a second: a speed that falls faster shows an impact."""


class Backwards(NamedTuple):
    """Masks of the rows (N,)."""

    sure: Mask
    perhaps: Mask  # backwards or downhill: the speed rises without throttle


def driven_backwards(
    speed_mph: Values, throttle: Values, brake: Values, time_s: Values, drive: NDArray[np.int64]
) -> Backwards:
    """The rows (N,) in which the car drives backwards. `time_s`: from `elapsed_s`; `drive`: the number of each
    row's drive. Takes any numbers. After an unknown speed (NaN), the direction is unknown."""
    nothing = np.zeros(len(speed_mph), np.bool_)
    is_known = np.abs(speed_mph) < 1e6  # False for NaN
    brake = np.fmax(brake, -throttle)  # some sources have one pedal, -1..1
    signed_mph = np.where(is_known, speed_mph, 0.0)
    if (signed_mph < SURELY_MPH).any():
        return Backwards(_reaching(signed_mph, drive), nothing)
    if len(speed_mph) < 2:
        return Backwards(nothing, nothing)
    mph = np.abs(signed_mph)
    is_joined = (np.diff(drive) == 0) & is_known[1:] & is_known[:-1]
    move = _moves(mph, is_joined)
    rise = np.where(is_joined, np.diff(mph), 0.0)
    fall = np.where(-rise < IMPACT_MPH_PER_S * np.diff(time_s), -rise, 0.0)
    is_pushed = _both(throttle > PEDAL)  # False for NaN
    is_braked = _both((brake > PEDAL) & ~(throttle > PEDAL))
    is_firm = is_braked & (brake > FIRM_BRAKE)[1:]
    is_free = _both(~(throttle > PEDAL)) & ~is_firm & is_pushed.any()  # without any, no throttle was recorded

    def total(change_mph: Values, when: Mask) -> Values:
        """The sum of the changes above 0 in each move."""
        return np.bincount(move, np.where(when, np.maximum(change_mph, 0.0), 0.0)).astype(np.float64)

    first = np.flatnonzero(np.diff(move, prepend=-1))  # of each move
    from_stand = mph[first] < TURN_MPH
    rolled = total(rise, is_free)
    reversed_mph = total(rise, is_firm) + np.minimum(rolled, total(fall, is_pushed))
    forwards_mph = total(rise, is_pushed) + np.where(from_stand, 0.0, total(fall, is_braked))
    is_backwards = (reversed_mph >= np.where(from_stand, RISE_MPH, ROLL_MPH)) & (reversed_mph > 2 * forwards_mph)
    perhaps = ~is_backwards & from_stand & (rolled >= ROLL_MPH) & (rolled > 2 * forwards_mph)
    return Backwards(_rows(is_backwards[move] & is_joined), _rows(perhaps[move] & is_joined))


def _both(mask: Mask) -> Mask:
    return mask[1:] & mask[:-1]


def _reaching(signed_mph: Values, drive: NDArray[np.int64]) -> Mask:
    reaches = np.zeros(len(signed_mph), np.bool_)
    for first, last in stretches_within(signed_mph < SIGNED_MPH, drive):
        reaches[first : last + 1] = signed_mph[first : last + 1].min() < SURELY_MPH
    return reaches


def _moves(mph: Values, is_joined: Mask) -> NDArray[np.int64]:
    """The number of the move, from one stop to the next, for each pair of neighbouring rows (N - 1,)."""
    is_turn = np.zeros(len(mph), np.bool_)
    is_turn[1:-1] = (mph[1:-1] < TURN_MPH) & (mph[1:-1] <= mph[:-2]) & (mph[1:-1] < mph[2:])
    is_first = is_turn[:-1] | ~is_joined  # pairs that begin a move
    is_first[1:] |= ~is_joined[:-1]
    number: NDArray[np.int64] = np.cumsum(is_first) - int(is_first[0])
    return number


def _rows(pairs: Mask) -> Mask:
    rows = np.zeros(len(pairs) + 1, np.bool_)
    rows[:-1] |= pairs
    rows[1:] |= pairs
    return rows
