"""Summaries of drives: the counts of `bc-drive`, events, and the car's path. A thread reads them, and the cache
keeps them."""

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
from recorder.bc_pb2 import PilotCommand
from recorder.log.meant_gaps import HUMAN_DRIVES
from recorder.log.session_car import max_steering_deg_of
from web.folders.background import Background
from web.folders.cache_folder import CacheFolder
from web.folders.project_folders import ProjectFolders

_MAX_POINTS: Final = 1500
_MAX_EVENTS: Final = 200
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
    """The sent steering minus that of the simulator's expert; None without an expert."""


class DriveView(msgspec.Struct, frozen=True):
    """A drive in the list of drives. `path` has at most 1,500 places; none if the log has no poses."""

    counted: dict[str, str]
    events: list[DriveEvent]
    path: list[CarPlace]


class DriveViews:
    """The views of all drives."""

    def __init__(self, folders: ProjectFolders, cache: CacheFolder, pool: Executor) -> None:
        self._folders = folders
        self._cache = cache
        self._views = Background[Location, DriveView](pool, self._view)

    @property
    def done(self) -> int:
        return self._views.done

    def views(self, logs: Iterable[Location], patience_s: float) -> dict[Location, DriveView | UserError]:
        """The views of the logs that are read within `patience_s`; a UserError for an unreadable log."""
        return self._views.results([(path, self._folders.version_of_log(path)) for path in logs], patience_s)

    def _view(self, log: Location, version: str) -> DriveView:
        def read() -> DriveView:
            self._folders.refuse_unanswered(log)
            return _read(log)

        return self._cache.struct(f"drive 3 {absolute(log)} {version}", DriveView, read)


def _read(path: Location) -> DriveView:
    with Log(path) as log:
        states = log.vehicle()
        rows, time_ns, mph = (states[name].to_numpy() for name in ("row", "log_time_ns", "speed_mph"))
        events = drive_events(log, rows, time_ns)
        sent: dict[int, tuple[int, float | None]] = {}
        if topics.PILOT_COMMAND in log.counts:
            full_deg = max_steering_deg_of(log)
            sent = {
                message.sequence: (command.driver, _error_deg(command, full_deg))
                for message, command in log.commands()
            }
        speeds = dict(zip(rows.tolist(), mph.tolist(), strict=True))
        path_of_car: list[CarPlace] = []
        if count := log.counts.get(topics.POSE, 0):
            step = count // _MAX_POINTS + 1
            for number, (message, pose) in enumerate(log.decoded(topics.POSE)):
                place = pose.pose.position
                if number % step == 0 and abs(place.x) < 1e6 and abs(place.y) < 1e6:
                    row = message.sequence
                    speed = speeds.get(row, 0.0)
                    speed = speed if abs(speed) < 1000 else 0.0
                    driver, error_deg = sent.get(row, (0, None))
                    path_of_car.append(
                        CarPlace(row, round(place.x, 2), round(place.y, 2), speed, driver, error_deg)
                    )
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


def _error_deg(command: PilotCommand, full_deg: float) -> float | None:
    if not command.HasField("expert_steering"):
        return None
    error_deg = abs(command.steering - command.expert_steering) * full_deg
    return round(error_deg, 2) if error_deg <= 2 * full_deg else None  # False for NaN
