"""The search for rows that meet a condition, as by `bc-index --where`."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Final

import pyarrow as pa

from common.location import Location
from dataset.config import IndexConfig
from dataset.frames.frames_file import check_where
from dataset.frames.frames_table import frames_table
from dataset.index.sessions import name_problem
from recorder import Log, LogError
from recorder.log.tags import read_tags, tags_path
from recorder.rows.condition import rows_where
from web.folders.background import Background
from web.folders.project_folders import ProjectFolders

_MAX_SEARCHES: Final = 8  # kept


class WhereSearches:
    """The latest conditions, with their results so far."""

    def __init__(self, folders: ProjectFolders, pool: Executor) -> None:
        self._folders = folders
        self._pool = pool
        self._lock = threading.Lock()
        self._searches: OrderedDict[str, Background[Location, int]] = OrderedDict()
        self._done = 0  # by searches that were dropped

    @property
    def done(self) -> int:
        with self._lock:
            return self._done + sum(search.done for search in self._searches.values())

    def rows(self, where: str, logs: Sequence[Location], patience_s: float | None) -> dict[Location, int]:
        """The number of rows that meet the condition in each log that is searched within `patience_s`; 0 for an
        unreadable log. Raises UsageError for an invalid condition."""
        with self._lock:
            search = self._searches.get(where)
        if search is None:
            check_where(where)
            search = Background[Location, int](self._pool, partial(self._count, where))
            with self._lock:
                self._searches[where] = search
                while len(self._searches) > _MAX_SEARCHES:
                    _, dropped = self._searches.popitem(last=False)
                    self._done += dropped.done
        version_of, version_of_log = self._folders.version_of, self._folders.version_of_log
        versions = [(path, f"{version_of_log(path)} {version_of(tags_path(path))}") for path in logs]
        results = search.results(versions, patience_s)
        return {path: rows if isinstance(rows, int) else 0 for path, rows in results.items()}

    def _count(self, where: str, path: Location, version: str) -> int:
        return len(self.numbers(where, path))

    def numbers(self, where: str, path: Location) -> set[int]:
        """The rows of a log that meet the condition. Raises UsageError for an invalid condition, and LogError
        for an unreadable log, and for one whose name is not text."""
        if problem := name_problem(path):
            raise LogError(problem)
        self._folders.refuse_unanswered(path)
        with Log(path) as log:
            frames = frames_table(log, self._folders.local_index, IndexConfig(), read_tags(path, log.fingerprint))
        return set(frames["row"].filter(pa.array(rows_where(frames, where))).to_pylist())
