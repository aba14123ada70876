"""Folders in stores: their listings, and copies of small folders and of the small files of runs. Threads refresh
them, at most every few seconds, for all pages together. Other files of runs are copied when a page needs them."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from common import UserError
from common.errors import StoreError, printable
from common.location import Url
from common.users_cache import cached_copy
from web.errors import report_bug
from web.folders.file_versions import version_of_stats

if TYPE_CHECKING:
    from common.object_store import StoredObject
    from model.runs.runs_in_store import RunInStore

Listing = Mapping[Url, "StoredObject"]
Value = TypeVar("Value")

EVERY_S: Final = 3.0
"""The least time between two refreshes."""
_BREAK: Final = 10  # times as long as it has taken: stores charge for each thousand names listed
_PATIENCE_S: Final = 1.5
_AT_ONCE: Final = 8  # runs


class Refreshed(Generic[Value]):
    """A value that a thread refreshes. Only the first calls of `refresh` wait a moment for it."""

    def __init__(self, name: str, make: Callable[[Value | None], Value]) -> None:
        """`name` is for messages. `make` gets the value before, and returns the new one."""
        self._make = make
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._next_s = self._first_s = 0.0
        self._has_result = threading.Event()
        self.value: Value | None = None
        """None until the first refresh has ended."""
        self.problem = f"{name}: the store has not answered yet"
        """Why there is no newer value; empty if there is."""

    def refresh(self) -> None:
        """Start a refresh, if the last one is long enough ago."""
        now_s = time.monotonic()
        with self._lock:
            self._first_s = self._first_s or now_s
            if self._thread is None and now_s >= self._next_s:
                # a daemon, unlike a pool: the process ends without waiting for it
                self._thread = threading.Thread(target=self._run, name="asking a store", daemon=True)
                self._thread.start()
        self._has_result.wait(max(0.0, self._first_s + _PATIENCE_S - now_s))

    def _run(self) -> None:
        began_s = time.monotonic()
        value, problem = self.value, ""
        try:
            value = self._make(value)
        except UserError as error:
            problem = printable(str(error))
        except OSError as error:
            problem = printable(f"{error.filename}: {error.strerror}")
        except Exception as error:
            problem = report_bug(error)
        now_s = time.monotonic()
        with self._lock:
            self.value, self.problem = value, problem
            self._next_s = now_s + max(EVERY_S, 0 if problem else _BREAK * (now_s - began_s))
            self._thread = None
        self._has_result.set()


class StoreListings:
    """The latest listings of folders in stores."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listed: dict[Url, Refreshed[Listing]] = {}
        # objects that pages have changed since the last listing began, and when
        self._changed: dict[Url, tuple[float, StoredObject | None]] = {}

    def objects(self, folder: Url) -> Listing:
        """The objects directly in a folder, by the last listing."""
        listed = self.of(folder)
        if listed.value is None:
            listed.refresh()
        with self._lock:
            changed = {url: stored for url, (_, stored) in self._changed.items() if url.parent == folder}
        objects = listed.value or {}
        if not changed:
            return objects
        return {url: stored for url, stored in {**objects, **changed}.items() if stored is not None}

    def refresh_object(self, url: Url) -> None:
        """Look up an object that a page has changed: the next listing may be seconds away."""
        from common.object_store import find_object  # an extra

        now_s = time.monotonic()
        with contextlib.suppress(StoreError):
            stored = find_object(url)
            with self._lock:
                self._changed[url] = now_s, stored

    def find(self, url: Url) -> StoredObject | None:
        return self.objects(url.parent).get(url)

    def of(self, folder: Url) -> Refreshed[Listing]:
        with self._lock:
            if folder not in self._listed:
                self._listed[folder] = Refreshed(str(folder), lambda before: self._list(folder))
            return self._listed[folder]

    def _list(self, folder: Url) -> Listing:
        began_s = time.monotonic()
        listing = _list(folder)
        with self._lock:
            listed = [url for url, (at_s, _) in self._changed.items() if url.parent == folder and at_s < began_s]
            for url in listed:
                del self._changed[url]
        return listing


class StoredCopy(Refreshed[Listing]):
    """A copy of a folder of small files. It is fetched again when its listing has changed.

    `bc-index` works in another copy, so that this one never blocks it.
    """

    def __init__(self, url: Url) -> None:
        super().__init__(str(url), self._fetch)
        self.folder = cached_copy(url, "shown")
        self._url = url

    def _fetch(self, before: Listing | None) -> Listing:
        listing = _list(self._url)
        if listing != before:
            from common.stored_folder import StoredFolder  # an extra

            with StoredFolder(self._url, self.folder, waits=True) as stored:
                stored.download()
        return listing


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


def _list(folder: Url) -> Listing:
    from common.object_store import list_objects  # an extra

    return {stored.url: stored for stored in list_objects(folder)}
