"""Logs that stay open between the requests of a page. A log is opened again when its file has changed."""

from __future__ import annotations

import threading
import weakref
from functools import cached_property
from pathlib import Path
from typing import Final

from common.car import CAMERAS, Camera
from recorder import Log
from recorder.log.road_places import states_of
from recorder.rows.row_quality import States
from recorder.topics import camera_topic
from web.folders.file_versions import version_of

MAX_OPEN: Final = 4
"""A log of an hour takes about 50 MB of memory."""


class OpenLog:
    """An open log with the data that several requests need. Its log is closed when nothing refers to it
    any more: keep it in a variable while you read."""

    def __init__(self, path: Path, version: str) -> None:
        self.log = Log(path)
        self.version = version
        """The version of the file, by `version_of`."""
        weakref.finalize(self, self.log.close)

    @cached_property
    def states(self) -> States:
        """The vehicle states, one for each row; empty for a log without them."""
        return states_of(self.log)

    @cached_property
    def cameras(self) -> list[Camera]:
        return [camera for camera in CAMERAS if len(self.log.pictures(camera_topic(camera)).sequence)]


class OpenLogs:
    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: dict[Path, OpenLog] = {}
        self._opening: dict[Path, threading.Lock] = {}

    def open(self, path: Path) -> OpenLog:
        """The log at a path. Raises LogError if it cannot be read."""
        version = version_of(path)
        with self._lock:
            opening = self._opening.setdefault(path, threading.Lock())
        with opening:  # simultaneous requests get the same log
            opened = self._kept.get(path)
            if opened is None or opened.version != version:
                opened = OpenLog(path, version)
            with self._lock:
                self._kept.pop(path, None)
                self._kept[path] = opened
                while len(self._kept) > MAX_OPEN:
                    self._kept.pop(next(iter(self._kept)))
        return opened

    def drop_changed(self) -> None:
        """Drop the logs whose files were deleted or replaced: an open file takes space on the disk."""
        with self._lock:
            self._kept = {path: kept for path, kept in self._kept.items() if kept.version == version_of(path)}

    def close(self) -> None:
        with self._lock:
            self._kept.clear()
