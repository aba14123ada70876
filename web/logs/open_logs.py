"""Logs that stay open between the requests of a page. A log is opened again when its file has changed."""

from __future__ import annotations

import contextlib
import threading
from collections import OrderedDict
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Final

from common.car import CAMERAS, Camera
from recorder import Log
from recorder.log.road_places import states_of
from recorder.rows.row_quality import States
from recorder.topics import camera_topic
from web.folders.file_versions import version_of

MAX_OPEN: Final = 8
MAX_MESSAGES: Final = 500_000
"""In all open logs together, if there are several. A message takes about 120 bytes of memory."""


class OpenLog:
    """An open log with the data that several requests need."""

    def __init__(self, path: Path, version: str) -> None:
        self.log = Log(path)
        self.version = version
        """The version of the file, by `version_of`."""
        self.messages = sum(self.log.counts.values())
        self.users = 0

    @cached_property
    def states(self) -> States:
        """The vehicle states, one for each row; empty for a log without them."""
        return states_of(self.log)

    @cached_property
    def cameras(self) -> list[Camera]:
        """The cameras that have pictures."""
        return [camera for camera in CAMERAS if len(self.log.pictures(camera_topic(camera)).sequence)]


class OpenLogs:
    """The logs used last. A dropped log is closed when no request uses it any more: otherwise another file might
    get its descriptor's number during a read."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[Path, OpenLog] = OrderedDict()
        self._opening: dict[Path, threading.Lock] = {}

    @contextlib.contextmanager
    def open(self, path: Path) -> Iterator[OpenLog]:
        """The log at a path. Raises LogError if it cannot be read."""
        version = version_of(path)
        with self._lock:
            opening = self._opening.setdefault(path, threading.Lock())
        with opening:  # simultaneous requests get the same log
            opened = self._used(path, version) or self._opened(path, version)
        try:
            yield opened
        finally:
            with self._lock:
                opened.users -= 1
                if not opened.users and self._kept.get(path) is not opened:
                    opened.log.close()

    def _used(self, path: Path, version: str) -> OpenLog | None:
        """The open log, with one more user; None if it is not open."""
        with self._lock:
            opened = self._kept.get(path)
            if opened is not None and opened.version != version:
                self._drop(path)
                opened = None
            if opened is not None:
                self._kept.move_to_end(path)
                opened.users += 1
        return opened

    def _opened(self, path: Path, version: str) -> OpenLog:
        opened = OpenLog(path, version)
        with self._lock:
            self._kept[path] = opened
            opened.users += 1
            while len(self._kept) > MAX_OPEN or (len(self._kept) > 1 and self._messages() > MAX_MESSAGES):
                self._drop(next(iter(self._kept)))
        return opened

    def _messages(self) -> int:
        return sum(opened.messages for opened in self._kept.values())

    def drop_changed(self) -> None:
        """Close the logs whose files were deleted or replaced: an open file takes space on the disk."""
        with self._lock:
            versions = {path: version_of(path) for path in self._kept}
            for path in [path for path, kept in self._kept.items() if kept.version != versions[path]]:
                self._drop(path)

    def close(self) -> None:
        with self._lock:
            for path in list(self._kept):
                self._drop(path)

    def _drop(self, path: Path) -> None:
        dropped = self._kept.pop(path)
        if not dropped.users:
            dropped.log.close()
