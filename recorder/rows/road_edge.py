"""How far a car is beyond the edge of its road, where its places are recorded and its road is built in."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.stretches import stretches_within

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]

OFF_S: Final = 0.5  # at least; a car that a drive's simulator puts back at once has not driven there
JOIN_S: Final = 2.0  # whoever leaves the road again so soon has not driven on it in between
_FARTHEST_M: Final = 1e6  # a place beyond is no place
_AT_ONCE: Final = 1024  # rows; with the points of a long track, some megabytes


def beyond_edge_m(track: str, fingerprint: str, x_m: Values, y_m: Values, heading_rad: Values) -> Values | None:
    """Metres (N,) by which the car's middle is beyond the road's edge, below 0 on the road, NaN without a place;
    None where no road of that name is built in, or it is another version's.

    Places are those of the middle of the rear axle, as `/pose` has them.
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
        at = np.flatnonzero((np.abs(places_m) < _FARTHEST_M).all(axis=0))
    points_m = road.line.points_m[:, :2]
    for rows in np.split(at, range(_AT_ONCE, len(at), _AT_ONCE)):
        away_m = np.hypot(*(places_m[axis, rows, None] - points_m[None, :, axis] for axis in (0, 1)))
        nearest = away_m.argmin(axis=1)
        beyond_m[rows] = away_m[np.arange(len(rows)), nearest] - road.half_width_m[nearest]
    return beyond_m


def off_road_rows(beyond_m: Values, time_s: Values, drive: NDArray[np.int64]) -> Mask:
    """The rows (N,) off the road, with what lies between two such stretches. `time_s` is that of `elapsed_s`,
    `drive` numbers the drives."""
    off = np.zeros(len(drive), np.bool_)
    last_before = -1
    for first, last in stretches_within(beyond_m > 0, drive):
        if time_s[last] - time_s[first] < OFF_S:
            continue
        joins = last_before >= 0 and time_s[first] - time_s[last_before] <= JOIN_S
        off[last_before + 1 if joins else first : last + 1] = True
        last_before = last
    return off
