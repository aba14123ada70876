"""The paths of drives on one map, as lines of an SVG: metres, north up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Final

from web.logs.drive_view import CarPlace, DriveEvent, DriveView

WAYS: Final = ("drive", "speed", "error", "who drove")
"""What the colours of a path can show."""
DRIVERS: Final = {0: "unknown", 1: "pilot", 2: "human", 3: "expert", 4: "brake"}
STEPS: Final = 6  # classes of speeds and errors, from zero to the largest
MAX_ERROR_DEG: Final = 12.0  # of steering; larger errors are in the last class, too
_MARGIN: Final = 0.04

Stroke = tuple[str, str]
"""A part of a path in one colour: its class in the style sheet, and its points."""
EventPlace = tuple[float, float, DriveEvent]
"""x and y of an event."""


@dataclass(frozen=True)
class DriveMap:
    box: str  # the SVG's viewBox
    size: float  # the longer side in metres
    strokes: list[list[Stroke]]  # of each drive
    places: list[list[EventPlace]]  # of each drive's interventions
    fastest_mph: float


def drive_map(drives: Sequence[DriveView], colours: Sequence[int], by: str) -> DriveMap | None:
    """The map of drives, with a colour for each, by one of `WAYS`; None if no drive has poses."""
    points = [(x, -y) for drive in drives for _, x, y, *_ in drive.path]
    if not points:
        return None
    xs, ys = zip(*points, strict=True)
    size = max(max(xs) - min(xs), max(ys) - min(ys), 1.0)
    edge = size * _MARGIN
    width, height = max(xs) - min(xs) + 2 * edge, max(ys) - min(ys) + 2 * edge
    box = f"{min(xs) - edge:.2f} {min(ys) - edge:.2f} {width:.2f} {height:.2f}"
    fastest = max([1.0, *(place.mph for drive in drives for place in drive.path)])
    strokes = [_strokes(drive, colour, by, fastest) for drive, colour in zip(drives, colours, strict=True)]
    return DriveMap(box, size, strokes, [_places(drive) for drive in drives], fastest)


def _strokes(drive: DriveView, colour: int, by: str, fastest: float) -> list[Stroke]:
    """The parts of a path with one colour each. A part begins where the one before it ends."""

    def style(place: CarPlace) -> str:
        if by == "speed":
            return f"step-{_step(place.mph, fastest)}"
        if by == "error":
            return "step-none" if place.error_deg is None else f"step-{_step(place.error_deg, MAX_ERROR_DEG)}"
        return f"by-{DRIVERS.get(place.driver, 'unknown')}" if by == "who drove" else f"drive-{colour}"

    strokes = []
    for name, part in groupby(pairwise(drive.path), key=lambda pair: style(pair[0])):
        pairs = list(part)
        places = [pairs[0][0], *(pair[1] for pair in pairs)]
        points = " ".join(f"{place.x_m:.2f},{-place.y_m:.2f}" for place in places)
        strokes.append((name, points))
    return strokes


def _step(value: float, largest: float) -> int:
    return min(STEPS - 1, int(STEPS * max(0.0, value) / largest))


def _places(drive: DriveView) -> list[EventPlace]:
    """The places of interventions. The place of one is the last point of the path that is not after it."""
    places = []
    for event in drive.events:
        before = [place for place in drive.path if place.row <= event.row] or drive.path[:1]
        if event.is_intervention and before:
            places.append((before[-1].x_m, -before[-1].y_m, event))
    return places
