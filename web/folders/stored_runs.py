"""Runs in a store: their small files are brought to the user's cache, where pages read them; the others when a
page needs them."""

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
    """The runs of a folder in a store by the folders of their copies; each when its small files are here."""

    def __init__(self, url: Url) -> None:
        super().__init__(str(url), self._bring_changed)
        self._url = url
        self._of_runs = threading.Lock()
        self._brought: dict[Path, RunInStore] = {}
        self._others: dict[tuple[Path, tuple[str, ...]], str] = {}  # the version that was brought

    def runs(self) -> Mapping[Path, RunInStore]:
        """The runs by the folders of their copies, in the order of their names."""
        with self._of_runs:
            return dict(sorted(self._brought.items(), key=lambda item: item[1].name))

    def url(self, run: Path) -> Url | None:
        with self._of_runs:
            found = self._brought.get(run)
        return found.url if found else None

    def version(self, run: Path, names: Sequence[str]) -> str:
        """The version of these files of a run, as they were listed last."""
        with self._of_runs:
            found = self._brought.get(run)
        files = [found.files.get(name) for name in names] if found else []
        return version_of_stats((each.url, (each.size, each.version)) for each in files if each is not None)

    def bring(self, run: Path, names: Sequence[str]) -> None:
        """Fetch those of these files that have changed since. Raises StoreError."""
        version = self.version(run, names)
        with self._of_runs:
            found = self._brought.get(run)
            if found is None or self._others.get((run, tuple(names))) == version:
                return
        from model.runs.runs_in_store import bring_run

        bring_run(found, names)
        with self._of_runs:
            self._others[run, tuple(names)] = version

    def _bring_changed(self, before: None) -> None:
        from model.runs.runs_in_store import bring_summary, runs_in_store

        def bring(run: RunInStore) -> UserError | None:
            try:
                here = bring_summary(run)
            except UserError as error:
                return error
            with self._of_runs:
                self._brought[here] = run
            return None

        there = {cached_copy(run.url): run for run in runs_in_store(self._url)}
        with self._of_runs:
            for removed in self._brought.keys() - there.keys():
                del self._brought[removed]
            changed = [run for here, run in there.items() if self._brought.get(here) != run]
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            problem = next(filter(None, pool.map(bring, changed)), None)
        if problem is not None:
            raise problem
