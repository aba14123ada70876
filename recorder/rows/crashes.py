"""Rows of crashes, and of the manoeuvres around them. There, the steering does not follow the road."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from common.stretches import stretches_within

if TYPE_CHECKING:
    from recorder.rows.row_quality import Motion

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
