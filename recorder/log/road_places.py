"""The poses of a log's car: its heading, its distance from the edge of a built-in road, and its last position."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from recorder import topics
from recorder.errors import LogError
from recorder.log.reader import Log
from recorder.rows.row_quality import States, Values

if TYPE_CHECKING:
    from foxglove_schemas_protobuf.Pose_pb2 import Pose

FARTHEST_M: Final = 1e6  # from the origin; positions beyond count as unknown
_AT_ONCE: Final = 1024  # rows compared with all points of a track: some megabytes
_FIELDS: Final = (
    "pose.position.x", "pose.position.y",
    "pose.orientation.x", "pose.orientation.y", "pose.orientation.z", "pose.orientation.w",
)  # fmt: skip


class CarPlaces:
    """The positions of a log while it is written: 56 bytes a row."""

    def __init__(self, session: Mapping[str, str] | None) -> None:
        self._session = session or {}
        self._values = array("d")

    def add(self, row: int, pose: Pose) -> None:
        if self._session.get("track"):
            at, turned = pose.position, pose.orientation
            self._values.extend((row, at.x, at.y, turned.x, turned.y, turned.z, turned.w))

    def placed(self, states: States) -> States:
        """The states with the car's headings, and its distances from the road's edge."""
        row, *places = np.array(self._values, np.float64).reshape(-1, 1 + len(_FIELDS)).T
        return _placed(states, self._session, row, places)


def states_of(log: Log) -> States:
    """The states of a log, with the car's headings and its distances from the road's edge, if known. Raises
    LogError for a damaged log."""
    states = States.of(log.vehicle())
    if not log.counts.get(topics.POSE):
        return states
    try:
        table = log.numbers(topics.POSE, _FIELDS)
    except LogError:  # a message that is no pose: the rest of a check does not need it
        return states
    return _placed(states, log.metadata, table["row"].to_numpy(), [table[name].to_numpy() for name in _FIELDS])


def _placed(states: States, session: Mapping[str, str], row: Values, places: list[Values]) -> States:
    if not len(row) or not len(states.row):
        return states
    x_m, y_m, x, y, z, w = places
    heading_rad = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    fingerprint = session.get("track_fingerprint", "")
    beyond_m = beyond_edge_m(session.get("track", ""), fingerprint, x_m, y_m, heading_rad)
    order = np.argsort(row, kind="stable")
    at = order[np.minimum(np.searchsorted(row[order], states.row), len(order) - 1)]

    def of_states(values: Values) -> Values:
        return np.where(row[at] == states.row, values[at], np.nan)

    beyond_m = None if beyond_m is None else of_states(beyond_m)
    return replace(states, heading_rad=of_states(heading_rad), beyond_m=beyond_m)


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


def last_place_m(log: Log) -> float | None:
    """The last position, in metres along the track's centre line from its start; None without a pose, or if the
    track is unknown. Raises LogError for a damaged log."""
    from simulator.driving.vehicle import AXLE_TO_CENTRE_M
    from simulator.roads.track import load_track

    try:
        line = load_track(log.metadata.get("track", "")).line
    except ValueError:
        return None
    table = log.numbers(topics.POSE, _FIELDS[:2])
    if not len(table):
        return None
    x_m, y_m = (table[name][-1].as_py() for name in _FIELDS[:2])
    if not (abs(x_m) < FARTHEST_M and abs(y_m) < FARTHEST_M):
        return None
    rear_m, _ = line.project(x_m, y_m)
    return (rear_m + AXLE_TO_CENTRE_M) % line.length_m
