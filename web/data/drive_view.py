"""A drive in short: what `bc-drive` has counted, its events, and where the car was; kept in the cache."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from common.errors import printable
from recorder import Log
from recorder.log import topics
from web.data.cache_folder import CacheFolder
from web.data.file_versions import version_of

_MOST_POINTS: Final = 1500
_MOST_EVENTS: Final = 200
_INTERVENTIONS: Final = ("off the road, or stuck", "the expert takes over", "manual: a human drives")


class DriveEvent(msgspec.Struct, frozen=True):
    """A message of the log, at the first row that is not before it."""

    row: int
    seconds: float  # since the first row
    text: str
    is_intervention: bool


class DriveView(msgspec.Struct, frozen=True):
    """`path`: x and y in metres, mph, and who drove, of at most so many rows; none where the log has no poses."""

    counted: dict[str, str]
    events: list[DriveEvent]
    path: list[tuple[int, float, float, float, int]]  # row, x, y, mph, bc.PilotCommand.Driver


def view_drive(log: Path, cache: CacheFolder) -> DriveView:
    """Raises LogError where the log cannot be read."""
    key = f"drive 1 {log.resolve()} {version_of(log)}"
    data = cache.get(key, lambda: msgspec.json.encode(_read(log)))
    try:
        return msgspec.json.decode(data, type=DriveView)
    except (msgspec.MsgspecError, UnicodeError):  # a file of the cache that is damaged
        cache.forget(key)
        return _read(log)


def _read(path: Path) -> DriveView:
    with Log(path) as log:
        states = log.vehicle()
        rows, time_ns, mph = (states[name].to_numpy() for name in ("row", "log_time_ns", "speed_mph"))
        events: list[DriveEvent] = []
        for message, told in log.decoded(topics.EVENTS) if topics.EVENTS in log.counts else ():
            if len(rows) and len(events) < _MOST_EVENTS:
                at = min(int(np.searchsorted(time_ns, message.log_time_ns)), len(rows) - 1)
                text = printable(told.message)[:300]
                seconds = float(time_ns[at] - time_ns[0]) / 1e9
                events.append(DriveEvent(int(rows[at]), seconds, text, text.startswith(_INTERVENTIONS)))
        drivers: dict[int, int] = {}
        if topics.PILOT_COMMAND in log.counts:
            drivers = {message.sequence: command.driver for message, command in log.commands()}
        speeds = dict(zip(rows.tolist(), mph.tolist(), strict=True))
        path_of_car = []
        if count := log.counts.get(topics.POSE, 0):
            step = count // _MOST_POINTS + 1
            for number, (message, found) in enumerate(log.decoded(topics.POSE)):
                place = found.pose.position
                if number % step == 0 and abs(place.x) < 1e6 and abs(place.y) < 1e6:
                    row = message.sequence
                    speed = speeds.get(row, 0.0)
                    speed = speed if abs(speed) < 1000 else 0.0
                    path_of_car.append((row, round(place.x, 2), round(place.y, 2), speed, drivers.get(row, 0)))
        counted = {
            printable(name): printable(value) for name, value in log.read_metadata(topics.DRIVE_METADATA).items()
        }
        return DriveView(counted, events, path_of_car)
