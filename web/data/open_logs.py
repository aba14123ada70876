"""Logs that stay open between the requests of a page, opened anew when the file is another one."""

from __future__ import annotations

import contextlib
import threading
from collections import OrderedDict
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from recorder import Log
from recorder.log.row_quality import States
from web.data.file_versions import version_of

_KEPT_OPEN: Final = 8


class OpenLog:
    """An open log with what several requests need of it."""

    def __init__(self, path: Path, version: str) -> None:
        self.log = Log(path)
        self.version = version
        """Of the file, by `version_of`."""
        self.users = 0

    @cached_property
    def states(self) -> States:
        """One for each row; of a log without vehicle states, none."""
        return States.of(self.log.vehicle())

    @cached_property
    def first_time_ns(self) -> int:
        return int(self.states.time_ns[0]) if len(self.states.time_ns) else 0

    def position(self, row: int) -> int | None:
        """Where among the rows the one of that number is."""
        found = np.flatnonzero(self.states.row == row)
        return int(found[0]) if len(found) else None


class OpenLogs:
    """The logs that were asked for last. A log is closed when it is not kept any more and nobody uses it: another
    file may else get the number of its descriptor while somebody reads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[Path, OpenLog] = OrderedDict()

    @contextlib.contextmanager
    def open(self, path: Path) -> Iterator[OpenLog]:
        """Raises LogError if it cannot be read."""
        version = version_of(path)
        with self._lock:
            found = self._kept.get(path)
            if found is not None and found.version != version:
                self._drop(path)
                found = None
            if found is not None:
                self._kept.move_to_end(path)
                found.users += 1
        if found is None:
            opened = OpenLog(path, version)
            with self._lock:
                if path in self._kept:  # two asked at once
                    self._drop(path)
                self._kept[path] = found = opened
                found.users += 1
                while len(self._kept) > _KEPT_OPEN:
                    self._drop(next(iter(self._kept)))
        try:
            yield found
        finally:
            with self._lock:
                found.users -= 1
                if not found.users and self._kept.get(path) is not found:
                    found.log.close()

    def drop_changed(self) -> None:
        """Close those whose files were deleted or replaced: an open file keeps its space on the disk."""
        with self._lock:
            for path in [path for path, kept in self._kept.items() if kept.version != version_of(path)]:
                self._drop(path)

    def close(self) -> None:
        with self._lock:
            for path in list(self._kept):
                self._drop(path)

    def _drop(self, path: Path) -> None:
        dropped = self._kept.pop(path)
        if not dropped.users:
            dropped.log.close()
