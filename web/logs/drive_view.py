"""A drive's course (who drove, steering, places, road), and summaries of drives for the list: the counts of
`bc-drive`, events, and the car's path; and the map of several drives. A thread reads the summaries, and the cache
keeps them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import groupby, islice, pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from common import UserError
from common.errors import printable
from common.untrusted import real_path
from drive.control.takeover import TAKES_OVER
from recorder import Log, topics
from recorder.log.meant_gaps import HUMAN_DRIVES
from recorder.log.session_car import max_steering_deg_of
from recorder.teleop.frame_state import road_named
from web.folders.cache_folder import PATIENCE_S, Background, CacheFolder
from web.folders.project_folders import version_of_log
from web.logs.open_logs import OpenLog
from web.processes.predictions import Values, at_rows

COLUMNS: Final = ("driver", "network", "sent", "expert", "x_m", "y_m")
_COMMAND: Final = ("driver", "predicted_steering", "steering", "expert_steering")
_PLACE: Final = ("pose.position.x", "pose.position.y")
_FARTHEST_M: Final = 1e6  # a place farther away is invalid


def is_driven(topics_of_log: Iterable[str]) -> bool:
    """Whether a log with these topics has a course: commands or poses."""
    return not {topics.PILOT_COMMAND, topics.POSE}.isdisjoint(topics_of_log)


def course_columns(log: Log, rows: NDArray[np.int64]) -> Values:
    """Return `COLUMNS` for the rows (N,) of a log: (6, N); NaN for missing values.

    The driver is a number of `PilotCommand.Driver`. Steering is -1 (left) to 1 (right); the network's is not
    clamped. Places are metres east and north. Raises LogError for a damaged log.
    """
    columns = np.full((len(COLUMNS), len(rows)), np.nan)
    for topic, fields, at in ((topics.PILOT_COMMAND, _COMMAND, 0), (topics.POSE, _PLACE, len(_COMMAND))):
        if log.counts.get(topic):
            table = log.numbers(topic, fields)
            values = np.stack([table[name].to_numpy() for name in fields])
            columns[at : at + len(fields)] = at_rows(table["row"].to_numpy(), values, rows)
    is_place = (np.abs(columns[4:]) < _FARTHEST_M).all(axis=0)  # False for NaN
    columns[4:, ~is_place] = np.nan
    return columns


def road_of(log: Log) -> dict[str, Any] | None:
    """The edges of the built-in road that a log names (`road_named`); None if it names none."""
    name = log.metadata.get("track", "")
    is_placed = name and log.counts.get(topics.POSE)
    return road_named(name, log.metadata.get("track_fingerprint", "")) if is_placed else None


_MAX_POINTS: Final = 1500
_MAX_EVENTS: Final = 200
BEFORE_S: Final = 3.0
"""Of driving before the car was put back: it shows the mistake, and not what to do."""
PUT_BACK: Final = "put back on its line"
"""In the events of a recording: a person left the road, or was stuck."""
_INTERVENTIONS: Final = ("off the road, or stuck", "the expert takes over", TAKES_OVER, HUMAN_DRIVES)


class DriveEvent(msgspec.Struct, frozen=True):
    """An event of a log, at the first row that is not before it."""

    row: int
    seconds: float  # since the first row
    text: str
    is_intervention: bool


class CarPlace(NamedTuple):
    """The car's place at a row, in metres."""

    row: int
    x_m: float
    y_m: float
    mph: float
    driver: int  # bc.PilotCommand.Driver
    error_deg: float | None
    """The difference of the sent steering from the expert's; None without an expert."""


class DriveView(msgspec.Struct, frozen=True):
    """A drive in the list of drives. `path` has at most 1,500 places; none if the log has no poses."""

    counted: dict[str, str]
    events: list[DriveEvent]
    path: list[CarPlace]


class DriveViews:
    def __init__(self, cache: CacheFolder, pool: Executor) -> None:
        self._cache = cache
        self._views = Background(pool, self._view)

    @property
    def done(self) -> int:
        return self._views.done

    def views(self, logs: Iterable[Path], patience_s: float = PATIENCE_S) -> dict[Path, DriveView | UserError]:
        """The views of the logs that are read within `patience_s`; a UserError for an unreadable log."""
        return self._views.results([(path, version_of_log(path)) for path in logs], patience_s)

    def _view(self, log: Path, version: str) -> DriveView:
        return self._cache.struct(f"drive 4 {real_path(log)} {version}", DriveView, lambda: _read(log))


def _read(path: Path) -> DriveView:
    with Log(path) as log:
        states = log.vehicle()
        rows, time_ns, mph = (states[name].to_numpy() for name in ("row", "log_time_ns", "speed_mph"))
        counted = {
            printable(name): printable(value) for name, value in log.read_metadata(topics.DRIVE_METADATA).items()
        }
        return DriveView(counted, drive_events(log, rows, time_ns), _path(log, rows, mph))


def _path(log: Log, rows: NDArray[np.int64], mph: NDArray[np.float64]) -> list[CarPlace]:
    """The car's places. `rows` and `mph` (N,) are of all states."""
    poses = log.numbers(topics.POSE, ("pose.position.x", "pose.position.y"))
    step = len(poses) // _MAX_POINTS + 1
    row, _, x_m, y_m = (column.to_numpy()[::step] for column in poses.columns)
    speeds = dict(zip(rows.tolist(), np.where(np.abs(mph) < 1000, mph, 0.0).tolist(), strict=True))
    commands = log.numbers(topics.PILOT_COMMAND, ("driver", "steering", "expert_steering"))
    command_rows, _, driver, steering, expert = (column.to_numpy() for column in commands.columns)
    full_deg = max_steering_deg_of(log)
    error_deg = np.abs(steering - expert) * full_deg
    errors = [round(error, 2) if error <= 2 * full_deg else None for error in error_deg.tolist()]  # None for NaN
    sent = dict(zip(command_rows.tolist(), zip(driver.astype(int).tolist(), errors, strict=True), strict=True))
    places = []
    for number, x, y in zip(row.tolist(), x_m.tolist(), y_m.tolist(), strict=True):
        if abs(x) < 1e6 and abs(y) < 1e6:
            places.append(
                CarPlace(number, round(x, 2), round(y, 2), speeds.get(number, 0.0), *sent.get(number, (0, None)))
            )
    return places


def drive_events(log: Log, rows: NDArray[np.int64], time_ns: NDArray[np.int64]) -> list[DriveEvent]:
    """The first events of a log with these rows, at these log times (N,)."""
    if topics.EVENTS not in log.counts or not len(rows):
        return []
    events = []
    for message, event in islice(log.decoded(topics.EVENTS), _MAX_EVENTS):
        at = min(int(np.searchsorted(time_ns, message.log_time_ns)), len(rows) - 1)
        text = printable(event.message)[:300]
        seconds = float(time_ns[at] - time_ns[0]) / 1e9
        is_intervention = text.startswith(_INTERVENTIONS) or PUT_BACK in text
        events.append(DriveEvent(int(rows[at]), seconds, text, is_intervention))
    return events


def rows_before_put_back(opened: OpenLog) -> list[tuple[int, int]]:
    """The first and last row of the `BEFORE_S` before each time that the car was put back on its line."""
    states = opened.states
    rows, time_ns = states.row, states.time_ns
    stretches = []
    for event in drive_events(opened.log, rows, time_ns):
        last = int(np.searchsorted(rows, event.row)) - 1
        if PUT_BACK in event.text and last >= 0:
            first = int(np.searchsorted(time_ns, time_ns[last] - round(BEFORE_S * 1e9)))
            stretches.append((int(rows[first]), int(rows[last])))
    return stretches


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
