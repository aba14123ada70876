"""Flags for odd rows of a log, and the drives that pauses separate, from its vehicle states alone.

Published recordings set the thresholds: people at keyboards hold an exact 0 for up to 14 s of driving, and any
other exact value for at most 2 s. The simulator writes at least five rows a second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.car import SPEED_RANGE_MPH
from common.stretches import runs, stretches_within

if TYPE_CHECKING:
    import pyarrow as pa


GAP_S: Final = 1.0
APART_S: Final = 1000.0  # more than any time over which rows are compared
STANDING_MPH: Final = 0.5
STUCK_S: Final = 3.0
STUCK_AT_ZERO_S: Final = 30.0

PARKED_S: Final = 5.0  # in recordings of people, an ordinary start waits for 1.6 to 3.2 s

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]
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
        columns: Any = [getattr(self, field.name) for field in fields(self)]
        parts: Any = [None if column is None else column[chosen] for column in columns]
        return States(*parts)

    @cached_property
    def flags(self) -> dict[str, Mask]:
        """The rows (N,) of each flag.

        - `gap`: the first row after a gap in time
        - `out_of_range`: steering outside -1..1, pedals outside 0..1, either NaN, or speed outside
          `SPEED_RANGE_MPH`
        - `standing_still`
        - `stuck_steering`: exactly the same steering for long while the car moves
        - `crash`: the car stands at an obstacle, or manoeuvres to get away from it
        - `backwards`
        - `manoeuvring`: the second before an impact, and the way out of a crash or of driving backwards
        - `parked`: the car stands for long, in a session in which it drives
        """
        return _flags(self)


@dataclass(frozen=True)
class Motion:
    """How the car of a log moves; arrays (N,), a number a row."""

    speed_mph: Values  # without sign, NaN if unknown
    standing: NDArray[np.bool_]
    usual_mph: float  # from `usual_speed_mph`
    time_s: Values  # from `elapsed_s`
    drive: NDArray[np.int64]  # from `drive_numbers`


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


def _flags(states: States) -> dict[str, Mask]:
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


CRASH_SPEED_SHARE: Final = 1 / 3  # of the session's usual speed, the median; drivers take bends faster
CRASH_S: Final = 0.5  # the shortest crash; a single row without speed is an error of the source
IMPACT_MPH: Final = 9.0
IMPACT_S: Final = 0.2
"""Tyres can brake half as hard (1 g, 22 mph a second): a car that loses so much speed so fast has hit
something."""
IMPACT_LEADS_S: Final = 0.5  # a car bounces and rolls out before it is slow
CRASH_LOCK: Final = 0.5
CRASH_LOCK_SHARE: Final = 0.25
"""A car whose wheels are at half lock or more in this share of rows manoeuvres. A car that stops steers
straight."""
APPROACH_S: Final = 1.0  # before an impact: at 30 mph, the last 13 m, in which the driver did not avoid it
_ROUNDING_S: Final = 1e-6  # evenly spaced rows lie exactly on the limit
WAY_OUT_S: Final = 3.0
WAY_OUT_SPEED_SHARE: Final = 1 / 2
BETWEEN_S: Final = 5.0  # less time between two crashes or reversals is not driving


def impact_rows(motion: Motion) -> Mask:
    """The rows (N,) right after an impact."""
    before_mph = np.interp(motion.time_s - IMPACT_S, motion.time_s, motion.speed_mph)
    hit: Mask = before_mph - motion.speed_mph >= IMPACT_MPH
    return hit


def crashed_rows(motion: Motion, steering: Values) -> Mask:
    """The rows (N,) of crashes: slow stretches in which the car stands, and which begin with an impact or have the
    wheels turned far for long. A slow stretch at the beginning of a drive is a start, not a crash."""
    time_s, drive, standing = motion.time_s, motion.drive, motion.standing
    crashed = np.zeros(len(drive), np.bool_)
    if not motion.usual_mph > 0 or not standing.any():  # NaN: it never moves
        return crashed
    is_hit = impact_rows(motion)
    turned = np.abs(steering) >= CRASH_LOCK
    for first, last in stretches_within(motion.speed_mph < CRASH_SPEED_SHARE * motion.usual_mph, drive):
        starts_drive = first == 0 or drive[first - 1] != drive[first]
        is_brief = time_s[last] - time_s[first] < CRASH_S
        if starts_drive or is_brief or not standing[first : last + 1].any():
            continue
        before = np.searchsorted(time_s, time_s[first] - IMPACT_LEADS_S)  # of the same drive: others are farther
        if is_hit[before : last + 1].any() or turned[first : last + 1].mean() >= CRASH_LOCK_SHARE:
            crashed[first : last + 1] = True
    return crashed


def manoeuvring_rows(motion: Motion, steering: Values, crashed: Mask, backwards: Mask) -> Mask:
    """The rows (N,) around crashes and driving backwards: the approach to an impact, the way out until the car
    drives again, and short times between two of them."""
    time_s = motion.time_s
    manoeuvring = np.zeros(len(time_s), np.bool_)
    is_odd = crashed | backwards
    if not is_odd.any():
        return manoeuvring
    is_hit = impact_rows(motion)
    is_leaving = motion.speed_mph < WAY_OUT_SPEED_SHARE * motion.usual_mph  # False for an unknown speed
    is_leaving |= np.abs(steering) >= CRASH_LOCK
    last_before = -1  # row of the previous stretch
    for first, last in stretches_within(is_odd, motion.drive):
        before = np.searchsorted(time_s, time_s[first] - IMPACT_LEADS_S)
        hits = before + np.flatnonzero(is_hit[before : last + 1])
        if crashed[first : last + 1].any() and len(hits):
            approach_s = time_s[min(hits[0], first)] - APPROACH_S - _ROUNDING_S
            manoeuvring[np.searchsorted(time_s, approach_s) : first] = True
        end = np.searchsorted(time_s, time_s[last] + WAY_OUT_S, side="right")
        drives_again = np.flatnonzero(~is_leaving[last + 1 : end])
        manoeuvring[last + 1 : last + 1 + drives_again[0] if len(drives_again) else end] = True
        if last_before >= 0 and time_s[first] - time_s[last_before] <= BETWEEN_S:
            manoeuvring[last_before + 1 : first] = True
        last_before = last
    return manoeuvring & ~is_odd


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
    row's drive. Takes any numbers. After an unknown speed (NaN), the direction is unknown.

    Udacity's simulator records the speed without its sign. Between two stops, a car keeps its direction. If its
    speed rises while the driver brakes, it drives backwards, from the previous stop to the next. If its speed
    rises without any pedal, it may also roll downhill: that is never sure.
    """
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
