"""`index/state.json`: sizes and times of the files from which an index was built, so that unchanged files are not
opened. If it is deleted, the next build reads all logs again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec

from common import atomic_file
from common.car import MAX_STEERING_DEG
from common.location import Location, Url
from dataset.frames.image_check_cache import image_check_path
from recorder.log.tags import tags_path
from recorder.rows.steering_habits import LagFinding

FRAMES_FOLDER: Final = "frames"
STATE_NAME: Final = "state.json"

Stat = tuple[int, int | str] | None
"""Size and time of modification (ns) of a file, or size and ETag of an object; None if it does not exist."""
Sources = tuple[str, Stat, Stat, Stat]


class BuiltLog(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    sources: Sources  # taken before the log was read, so that the next build notices later changes
    fingerprint: str = ""  # of the content; "" if the log was left out
    file: str = ""  # fingerprint of the file, on which the places of the pictures depend
    frames: Stat = None  # of the frames file
    notice: str = ""  # a line for the user
    has_crcs: bool = True
    driven_by: str = ""  # the machine that drove
    set_speeds_mph: tuple[float, ...] = ()  # of the driver
    sizes_px: list[tuple[int, int]] = []  # width and height of the first picture of each camera
    max_steering_deg: float | None = MAX_STEERING_DEG  # of the wheels at steering 1; None: unknown
    source: str = ""  # origin of imported data (`foreign_source`)
    car: str = ""  # as stored in the log, JSON
    lag: LagFinding | None = None  # of the steering, if it was measured before
    lag_file: Stat = None  # of the file with the lag, next to the log
    is_mixed: bool = False  # in a store, with rows and pictures mixed: all of the log was downloaded


class BuildState(msgspec.Struct, frozen=True):
    samples: Stat
    logs: dict[str, BuiltLog]
    passed_over: list[str]  # logs that the user left out

    @classmethod
    def nothing(cls) -> BuildState:
        return cls(None, {}, [])


class Stats:
    """Returns the state of a file. For objects in a store, each folder is listed once."""

    def __init__(self) -> None:
        self._listed: dict[Url, dict[Url, Stat]] = {}

    def __call__(self, place: Location) -> Stat:
        if isinstance(place, Path):
            return stat_of(place)
        if place.parent not in self._listed:
            from common.object_store import list_objects  # an extra

            objects = list_objects(place.parent)
            self._listed[place.parent] = {entry.url: (entry.size, entry.version) for entry in objects}
        return self._listed[place.parent].get(place)


def stat_of(path: Location) -> Stat:
    if isinstance(path, Url):
        from common.object_store import find_object  # an extra

        stored = find_object(path)
        return None if stored is None else (stored.size, stored.version)
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


def sources_of(session: str, log: Location, index: Path, stat: Callable[[Location], Stat] = stat_of) -> Sources:
    """The state of the files on which a session's frames depend: the log, its tags, and the check of its
    pictures."""
    path = os.path.realpath(log) if isinstance(log, Path) else str(log)
    return path, stat(log), stat(tags_path(log)), stat_of(image_check_path(index, session))


def read_state(index: Path) -> BuildState:
    """The state of the last build; an empty state if the file is missing, damaged, or of an older version."""
    try:
        # not msgspec.json, which rejects names that are not UTF-8
        stored = json.loads((index / STATE_NAME).read_bytes())
        return msgspec.convert(stored, BuildState)
    except (OSError, ValueError):
        return BuildState.nothing()


def write_state(path: Path, state: BuildState) -> None:
    with atomic_file(path, overwrite=True) as part:
        stored = json.dumps(msgspec.to_builtins(state), indent=1, sort_keys=True)
        part.write_text(stored + "\n", encoding="utf-8")
