"""Where the car of a log stood last, along its built-in track."""

from __future__ import annotations

from recorder import topics
from recorder.log.reader import Log
from simulator.driving.vehicle import AXLE_TO_CENTRE_M
from simulator.roads.track import load_track

_MAX_M = 1e6


def last_place_m(log: Log) -> float | None:
    """Metres along the track's centre line from its start; None without a pose, or where the track is unknown.

    Raises LogError for a damaged log.
    """
    try:
        line = load_track(log.metadata.get("track", "")).line
    except ValueError:
        return None
    position = None
    for _, message in log.decoded(topics.POSE) if topics.POSE in log.counts else ():
        position = message.pose.position
    if position is None or not (abs(position.x) < _MAX_M and abs(position.y) < _MAX_M):
        return None
    rear_m, _ = line.project(position.x, position.y)
    return (rear_m + AXLE_TO_CENTRE_M) % line.length_m
