"""Rows of crashes, and of the manoeuvres about them: the steering there has nothing to do with the road."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.stretches import stretches_within

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

CRASH_SPEED_SHARE: Final = 1 / 3  # of the speed that is usual in the session, the median: bends are taken at more
CRASH_S: Final = 0.5  # at least; a single row of no speed is a fault of the source
IMPACT_MPH: Final = 9.0
IMPACT_S: Final = 0.2
"""So much speed lost in so short a time is twice what tyres can brake (1 g, 22 mph a second): an impact."""
IMPACT_LEADS_S: Final = 0.5  # a car bounces, and rolls out, before it is slow
CRASH_LOCK: Final = 0.5
CRASH_LOCK_SHARE: Final = 0.25
"""A wheel at half lock or more in so many of its rows is manoeuvring; to stop and start, it is straight."""
APPROACH_S: Final = 1.0  # before an impact; somebody who steers 13 m before a wall at 30 mph has not kept off it
_ROUNDING_S: Final = 1e-6  # rows at even times lie on the edge
WAY_OUT_S: Final = 3.0
WAY_OUT_SPEED_SHARE: Final = 1 / 2
BETWEEN_S: Final = 5.0  # whoever has to reverse or hits something again so soon has not been driving in between


def impact_rows(speed_mph: Values, time_s: Values) -> Mask:
    """The rows (N,) right behind an impact; arguments are those of `crashed_rows`."""
    hit: Mask = np.interp(time_s - IMPACT_S, time_s, speed_mph) - speed_mph >= IMPACT_MPH
    return hit


def crashed_rows(
    speed_mph: Values, steering: Values, standing: Mask, usual_mph: float, time_s: Values, drive: NDArray[np.int64]
) -> Mask:
    """The rows (N,) of stretches far below the usual speed in which the car stands, and which an impact began or
    in which the wheel is turned far for long. One that begins a drive is a start, whatever the wheel does: nothing
    was driven into.

    Speeds are without a sign, NaN where they are unknown; `time_s` is that of `elapsed_s`, `drive` numbers the
    drives. A session that is slow throughout has a slow usual speed, and in a hairpin nobody stands.
    """
    crashed = np.zeros(len(drive), np.bool_)
    if not usual_mph > 0 or not standing.any():  # NaN: it never moves
        return crashed
    is_hit = impact_rows(speed_mph, time_s)
    turned = np.abs(steering) >= CRASH_LOCK
    for first, last in stretches_within(speed_mph < CRASH_SPEED_SHARE * usual_mph, drive):
        starts_drive = first == 0 or drive[first - 1] != drive[first]
        is_brief = time_s[last] - time_s[first] < CRASH_S
        if starts_drive or is_brief or not standing[first : last + 1].any():
            continue
        before = np.searchsorted(time_s, time_s[first] - IMPACT_LEADS_S)  # no earlier drive is so near
        if is_hit[before : last + 1].any() or turned[first : last + 1].mean() >= CRASH_LOCK_SHARE:
            crashed[first : last + 1] = True
    return crashed


def manoeuvring_rows(
    crashed: Mask,
    backwards: Mask,
    speed_mph: Values,
    steering: Values,
    usual_mph: float,
    time_s: Values,
    drive: NDArray[np.int64],
) -> Mask:
    """The rows (N,) that belong to crashes and to driving backwards, and are neither: the approach to an impact,
    the way out until the car drives again, and what lies between two of them. Arguments are those of
    `crashed_rows`."""
    manoeuvring = np.zeros(len(drive), np.bool_)
    is_odd = crashed | backwards
    if not is_odd.any():
        return manoeuvring
    is_hit = impact_rows(speed_mph, time_s)
    is_leaving = speed_mph < WAY_OUT_SPEED_SHARE * usual_mph  # False for an unknown speed
    is_leaving |= np.abs(steering) >= CRASH_LOCK
    last_before = -1  # of the stretch before
    for first, last in stretches_within(is_odd, drive):
        hits = np.flatnonzero(is_hit[np.searchsorted(time_s, time_s[first] - IMPACT_LEADS_S) : last + 1])
        if crashed[first : last + 1].any() and len(hits):
            hit = np.searchsorted(time_s, time_s[first] - IMPACT_LEADS_S) + hits[0]
            manoeuvring[np.searchsorted(time_s, time_s[min(hit, first)] - APPROACH_S - _ROUNDING_S) : first] = True
        end = np.searchsorted(time_s, time_s[last] + WAY_OUT_S, side="right")
        stays = np.flatnonzero(~is_leaving[last + 1 : end])
        manoeuvring[last + 1 : last + 1 + stays[0] if len(stays) else end] = True
        if last_before >= 0 and time_s[first] - time_s[last_before] <= BETWEEN_S:
            manoeuvring[last_before + 1 : first] = True
        last_before = last
    return manoeuvring & ~is_odd
