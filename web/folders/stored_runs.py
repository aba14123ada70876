"""Runs in a store. Their small files are copied to the user's cache, where pages read them. Other files are copied
when a page needs them."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Final

from common import UserError
from common.location import Url
from common.users_cache import cached_copy
from web.folders.file_versions import version_of_stats
from web.folders.stored_folders import Refreshed

if TYPE_CHECKING:
    from model.runs.runs_in_store import RunInStore

_AT_ONCE: Final = 8  # runs


class StoredRuns(Refreshed[None]):
    """The runs of a folder in a store, as soon as their small files are copied."""

    def __init__(self, url: Url) -> None:
        super().__init__(str(url), self._bring_changed)
        self._url = url
        self._runs_lock = threading.Lock()
        self._runs: dict[Path, RunInStore] = {}
        self._other_files: dict[tuple[Path, tuple[str, ...]], str] = {}  # the version that was brought

    def runs(self) -> Mapping[Path, RunInStore]:
        """The runs by the folders of their copies, in the order of their names."""
        with self._runs_lock:
            return dict(sorted(self._runs.items(), key=lambda item: item[1].name))

    def url(self, run: Path) -> Url | None:
        stored = self._stored(run)
        return stored.url if stored else None

    def version(self, run: Path, names: Sequence[str]) -> str:
        """The version of these files of a run, by the last listing."""
        stored = self._stored(run)
        files = [stored.files.get(name) for name in names] if stored else []
        return version_of_stats((file.url, (file.size, file.version)) for file in files if file is not None)

    def bring(self, run: Path, names: Sequence[str]) -> None:
        """Fetch these files if they have changed since the last time. Raises StoreError."""
        version, stored = self.version(run, names), self._stored(run)
        if stored is None or self._other_files.get((run, tuple(names))) == version:
            return
        from model.runs.runs_in_store import bring_run

        bring_run(stored, names)
        self._other_files[run, tuple(names)] = version

    def _stored(self, run: Path) -> RunInStore | None:
        with self._runs_lock:
            return self._runs.get(run)

    def _bring_changed(self, before: None) -> None:
        from model.runs.runs_in_store import bring_summary, runs_in_store

        def bring(run: RunInStore) -> UserError | None:
            try:
                copy = bring_summary(run)
            except UserError as error:
                return error
            with self._runs_lock:
                self._runs[copy] = run
            return None

        runs = {cached_copy(run.url): run for run in runs_in_store(self._url)}
        with self._runs_lock:
            for removed in self._runs.keys() - runs.keys():
                del self._runs[removed]
            changed = [run for copy, run in runs.items() if self._runs.get(copy) != run]
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            problem = next(filter(None, pool.map(bring, changed)), None)
        if problem is not None:
            raise problem
