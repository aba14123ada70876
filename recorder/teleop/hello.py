"""What a page is told first about a drive: where it is, what is recorded, and the road for its map."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Final, Literal

import numpy as np

from simulator.roads.track import Track, load_track

_EDGE_EVERY_M: Final = 4.0


def hello(
    kind: Literal["record", "listen", "drive"],
    log: Path,
    *,
    track: Track | None = None,
    run: str | None = None,
    rate_hz: float | None = None,
    picture_hz: float | None = None,
    hold_mph: float = 10.0,
) -> dict[str, object]:
    """The message "hello" of a `Wheel`. `rate_hz`: recorded rows a second; None where the simulator decides."""
    return {
        "kind": kind,
        "session": log.stem,
        "run": run,
        "track": None if track is None else track.name,
        "road": None if track is None else road_edges(track),
        "rate_hz": rate_hz,
        "picture_hz": picture_hz,
        "hold_mph": hold_mph,
    }


def road_edges(track: Track) -> dict[str, object]:
    """The road's edges as closed lines of points in metres, x east and y north."""
    line = track.line
    every = max(1, round(_EDGE_EVERY_M / line.step_m))
    middle, heading = line.points_m[::every, :2], line.heading_rad[::every]
    to_left = np.stack([-np.sin(heading), np.cos(heading)], axis=1) * track.half_width_m[::every, None]
    edges = {"left": middle + to_left, "right": middle - to_left}
    return {name: points.round(2).tolist() for name, points in edges.items()} | {"closed": True}


@lru_cache(8)
def road_named(name: str, fingerprint: str = "") -> dict[str, object] | None:
    """The edges of the built-in road of that name (`road_edges`); None for any other name, and where its
    `Track.fingerprint` is known and another one: another version had that road."""
    try:
        track = load_track(name)
    except ValueError:
        return None
    return road_edges(track) if fingerprint in ("", track.fingerprint()) else None
