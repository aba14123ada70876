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
from recorder.rows.road_edge import FARTHEST_M, Values, beyond_edge_m
from recorder.rows.row_quality import States

if TYPE_CHECKING:
    from foxglove_schemas_protobuf.Pose_pb2 import Pose

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
