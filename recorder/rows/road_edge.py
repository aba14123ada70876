"""The distance of a car from the edge of a built-in road."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.stretches import stretches_within

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

OFF_S: Final = 0.5  # the shortest stretch: drives put a car back at once
JOIN_S: Final = 2.0  # a shorter time between two stretches is not driving
FARTHEST_M: Final = 1e6  # from the origin; positions beyond count as unknown
_AT_ONCE: Final = 1024  # rows compared with all points of a track: some megabytes


def beyond_edge_m(track: str, fingerprint: str, x_m: Values, y_m: Values, heading_rad: Values) -> Values | None:
    """Metres (N,) from the road's edge to the car's middle: below 0 on the road, NaN if the position is unknown.
    None if no road of that name and version is built in.

    Positions are of the middle of the rear axle, as in `/pose`.
    """
    from simulator.driving.vehicle import AXLE_TO_CENTRE_M
    from simulator.roads.track import load_track

    try:
        road = load_track(track)
    except ValueError:
        return None
    if fingerprint not in ("", road.fingerprint()):
        return None
    beyond_m = np.full(len(x_m), np.nan)
    with np.errstate(invalid="ignore"):
        places_m = np.stack([x_m, y_m]) + AXLE_TO_CENTRE_M * np.stack([np.cos(heading_rad), np.sin(heading_rad)])
        at = np.flatnonzero((np.abs(places_m) < FARTHEST_M).all(axis=0))
    points_m = road.line.points_m[:, :2]
    for rows in np.split(at, range(_AT_ONCE, len(at), _AT_ONCE)):
        away_m = np.hypot(*(places_m[axis, rows, None] - points_m[None, :, axis] for axis in (0, 1)))
        nearest = away_m.argmin(axis=1)
        beyond_m[rows] = away_m[np.arange(len(rows)), nearest] - road.half_width_m[nearest]
    return beyond_m


def off_road_rows(beyond_m: Values, time_s: Values, drive: NDArray[np.int64]) -> Mask:
    """The rows (N,) off the road, including short returns. `time_s`: from `elapsed_s`; `drive`: the number of each
    row's drive."""
    off = np.zeros(len(drive), np.bool_)
    last_before = -1
    for first, last in stretches_within(beyond_m > 0, drive):
        if time_s[last] - time_s[first] < OFF_S:
            continue
        joins = last_before >= 0 and time_s[first] - time_s[last_before] <= JOIN_S
        off[last_before + 1 if joins else first : last + 1] = True
        last_before = last
    return off
