"""The search for rows that meet a condition, as by `bc-index --where`."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Final

import pyarrow as pa

from dataset.config import IndexConfig
from dataset.frames.frames_file import check_where
from dataset.frames.frames_table import frames_table
from dataset.index.sessions import name_problem
from recorder import Log, LogError
from recorder.log.tags import read_tags, tags_path
from recorder.rows.condition import rows_where
from web.folders.background import Background
from web.folders.file_versions import version_of
from web.folders.project_folders import ProjectFolders, version_of_log

_MAX_SEARCHES: Final = 8  # kept


class WhereSearches:
    """The latest conditions, with their results so far."""

    def __init__(self, folders: ProjectFolders, pool: Executor) -> None:
        self._folders = folders
        self._pool = pool
        self._lock = threading.Lock()
        self._searches: OrderedDict[str, Background[int]] = OrderedDict()
        self._done = 0  # by searches that were dropped

    @property
    def done(self) -> int:
        with self._lock:
            return self._done + sum(search.done for search in self._searches.values())

    def rows(self, where: str, logs: Sequence[Path], patience_s: float | None) -> dict[Path, int]:
        """The number of rows that meet the condition in each log that is searched within `patience_s`; 0 for an
        unreadable log. Raises UsageError for an invalid condition."""
        with self._lock:
            search = self._searches.get(where)
        if search is None:
            check_where(where)
            search = Background[int](self._pool, partial(self._count, where))
            with self._lock:
                self._searches[where] = search
                while len(self._searches) > _MAX_SEARCHES:
                    _, dropped = self._searches.popitem(last=False)
                    self._done += dropped.done
        versions = [(path, f"{version_of_log(path)} {version_of(tags_path(path))}") for path in logs]
        results = search.results(versions, patience_s)
        return {path: rows if isinstance(rows, int) else 0 for path, rows in results.items()}

    def _count(self, where: str, path: Path, version: str) -> int:
        return len(self.numbers(where, path))

    def numbers(self, where: str, path: Path) -> set[int]:
        """The rows of a log that meet the condition. Raises UsageError for an invalid condition, and LogError
        for an unreadable log, and for one whose name is not text."""
        if problem := name_problem(path):
            raise LogError(problem)
        with Log(path) as log:
            frames = frames_table(log, self._folders.index, IndexConfig(), read_tags(path, log.fingerprint))
        return set(frames["row"].filter(pa.array(rows_where(frames, where))).to_pylist())
