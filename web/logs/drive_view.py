"""Summaries of drives: the results of `bc-drive`, the events and the car's path. A thread reads the logs. The
cache keeps the summaries."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Executor
from itertools import islice
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from common import UserError
from common.errors import printable
from common.location import Location, absolute
from drive.control.takeover import TAKES_OVER
from recorder import Log, topics
from recorder.log.meant_gaps import HUMAN_DRIVES
from web.folders.background import Background
from web.folders.cache_folder import CacheFolder
from web.folders.project_folders import ProjectFolders

_MAX_POINTS: Final = 1500
_MAX_EVENTS: Final = 200
_INTERVENTIONS: Final = ("off the road, or stuck", "the expert takes over", TAKES_OVER, HUMAN_DRIVES)


class DriveEvent(msgspec.Struct, frozen=True):
    """A message of the log, at the first row that is not before it."""

    row: int
    seconds: float  # since the first row
    text: str
    is_intervention: bool


class CarPlace(NamedTuple):
    """The car's place at a row, in metres."""

    row: int
    x_m: float
    y_m: float


class DriveView(msgspec.Struct, frozen=True):
    """A drive as the list of drives shows it. `path` has at most `_MAX_POINTS` places; none without poses."""

    counted: dict[str, str]
    events: list[DriveEvent]
    path: list[CarPlace]


class DriveViews:
    """The views of all drives that are shown."""

    def __init__(self, folders: ProjectFolders, cache: CacheFolder, pool: Executor) -> None:
        self._folders = folders
        self._cache = cache
        self._views = Background[Location, DriveView](pool, self._view)

    @property
    def done(self) -> int:
        return self._views.done

    def views(self, logs: Iterable[Location], patience_s: float) -> dict[Location, DriveView | UserError]:
        """The views of logs that could be read by then; a UserError for each that cannot be."""
        return self._views.results([(path, self._folders.version_of_log(path)) for path in logs], patience_s)

    def _view(self, log: Location, version: str) -> DriveView:
        def read() -> DriveView:
            self._folders.refuse_unanswered(log)
            return _read(log)

        return self._cache.struct(f"drive 4 {absolute(log)} {version}", DriveView, read)


def _read(path: Location) -> DriveView:
    with Log(path) as log:
        states = log.vehicle()
        events = drive_events(log, states["row"].to_numpy(), states["log_time_ns"].to_numpy())
        path_of_car: list[CarPlace] = []
        step = log.counts.get(topics.POSE, 0) // _MAX_POINTS + 1
        for message, pose in islice(log.decoded(topics.POSE), 0, None, step):
            place = pose.pose.position
            if abs(place.x) < 1e6 and abs(place.y) < 1e6:
                path_of_car.append(CarPlace(message.sequence, round(place.x, 2), round(place.y, 2)))
        counted = {
            printable(name): printable(value) for name, value in log.read_metadata(topics.DRIVE_METADATA).items()
        }
        return DriveView(counted, events, path_of_car)


def drive_events(log: Log, rows: NDArray[np.int64], time_ns: NDArray[np.int64]) -> list[DriveEvent]:
    """The first events of a log with these rows, at these log times (N,)."""
    if topics.EVENTS not in log.counts or not len(rows):
        return []
    events = []
    for message, event in islice(log.decoded(topics.EVENTS), _MAX_EVENTS):
        at = min(int(np.searchsorted(time_ns, message.log_time_ns)), len(rows) - 1)
        text = printable(event.message)[:300]
        seconds = float(time_ns[at] - time_ns[0]) / 1e9
        events.append(DriveEvent(int(rows[at]), seconds, text, text.startswith(_INTERVENTIONS)))
    return events
