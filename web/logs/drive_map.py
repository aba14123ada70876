"""The paths of drives on one map, as lines of an SVG: metres, north up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from web.logs.drive_view import DriveEvent, DriveView

_MARGIN: Final = 0.04


@dataclass(frozen=True)
class EventPlace:
    """Where an intervention was, in the coordinates of the map."""

    x: float
    y: float
    event: DriveEvent


@dataclass(frozen=True)
class DriveMap:
    """A map of several drives; `paths` and `interventions` have an entry for each drive."""

    box: str  # the SVG's viewBox
    size: float  # the longer side in metres
    paths: list[str]  # the points of a polyline
    interventions: list[list[EventPlace]]


def drive_map(drives: Sequence[DriveView]) -> DriveMap | None:
    """Returns None if no drive has poses."""
    points = [(place.x_m, -place.y_m) for drive in drives for place in drive.path]
    if not points:
        return None
    xs, ys = zip(*points, strict=True)
    size = max(max(xs) - min(xs), max(ys) - min(ys), 1.0)
    edge = size * _MARGIN
    width, height = max(xs) - min(xs) + 2 * edge, max(ys) - min(ys) + 2 * edge
    box = f"{min(xs) - edge:.2f} {min(ys) - edge:.2f} {width:.2f} {height:.2f}"
    paths = [" ".join(f"{place.x_m:.2f},{-place.y_m:.2f}" for place in drive.path) for drive in drives]
    return DriveMap(box, size, paths, [_interventions(drive) for drive in drives])


def _interventions(drive: DriveView) -> list[EventPlace]:
    """The interventions of a drive, each at the last point of the path that is not after it."""
    places = []
    for event in drive.events:
        before = [place for place in drive.path if place.row <= event.row] or drive.path[:1]
        if event.is_intervention and before:
            places.append(EventPlace(before[-1].x_m, -before[-1].y_m, event))
    return places
