"""Runs in a store: their listing, and copies in the user's cache, for which only new files are fetched.

No PyTorch is needed for it. A folder of runs there is listed in one request (for a thousand objects). Results that
are added to a copy go up: see `send_results`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

from common.location import Location, Url, is_in_store, location
from common.progress import track
from common.store_record import cached_from, read_record
from model.errors import RunError
from model.runs.run_arguments import suggest_runs
from model.runs.run_files import CONFIG, RESULTS_FILE, WEIGHTS
from model.runs.training_progress import METRICS_FILE

if TYPE_CHECKING:
    from rich.progress import Progress

    from common.object_store import StoredObject
    from common.stored_folder import StoredFolder

SUMMARY_FILES: Final = (CONFIG, METRICS_FILE, RESULTS_FILE)
"""The files that a summary of a run is made of: a few kilobytes."""

ADDED_TO: Final = (RESULTS_FILE,)
"""Files of a run to which any machine adds lines."""

_AT_ONCE: Final = 8  # runs


@dataclass(frozen=True)
class RunInStore:
    """A run in a listing of a store."""

    url: Url
    files: Mapping[str, StoredObject]
    """By their paths in the run's folder."""

    @property
    def name(self) -> str:
        return self.url.name

    @property
    def has_weights(self) -> bool:
        """Whether an epoch is finished."""
        return WEIGHTS in self.files

    @property
    def written_ns(self) -> int:
        """The time at which its weights, or its config where it has none yet, were written there; since 1970."""
        return self.files[WEIGHTS if self.has_weights else CONFIG].written_ns


def runs_in_store(runs: Url) -> list[RunInStore]:
    """All runs in a folder, by name. Raises StoreError."""
    from common.object_store import list_below  # an extra

    by_run: dict[str, list[StoredObject]] = {}
    for stored in list_below(runs):
        name, slash, _ = stored.url.name_in(runs).partition("/")
        if slash and is_name(name):
            by_run.setdefault(name, []).append(stored)
    all_runs = (_run_of(runs / name, objects) for name, objects in sorted(by_run.items()))
    return [run for run in all_runs if CONFIG in run.files]


def find_in_store(name: str | None, runs: Location) -> RunInStore | None:
    """A run by its URL, or by name where `runs` is in a store; without a name, the one whose weights were written
    last. None for a run of this machine.

    Raises RunError, which names the runs there, if it does not exist; StoreError.
    """
    if name is None:
        return _newest(runs) if isinstance(runs, Url) else None
    url = location(name) if is_in_store(name) else runs / name if is_name(name) else None
    if not isinstance(url, Url):
        return None
    from common.object_store import list_below  # an extra

    run = _run_of(url, list_below(url))
    if CONFIG not in run.files:
        names = [other.name for other in runs_in_store(url.parent)] if url.parent.key else []
        suggestion = suggest_runs(url.name, names, url.parent)
        raise RunError(f"{url}: no run there ({CONFIG} is missing); {suggestion}")
    return run


def bring_run(run: RunInStore, wanted: Collection[str] | None = None, progress: Progress | None = None) -> Path:
    """A copy of a listed run in the user's cache; with `wanted`, of these files only.
    `progress` gets a line while something is fetched. Raises StoreError."""
    with stored_run_folder(run.url) as folder:
        folder.download(objects=run.files.values(), wanted=wanted, progress=progress)
        return folder.local.absolute()


def bring_summaries(runs: Url) -> Iterator[tuple[RunInStore, Path]]:
    """All runs in a folder, by name, and copies of their `SUMMARY_FILES`: only files that have changed since the
    last time are fetched. A bar counts the runs.

    The weights are fetched too where only they show whether a run's results are theirs, because no toolkit has
    written its record there. Raises StoreError.
    """
    stored_runs = runs_in_store(runs)
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        brought = zip(stored_runs, pool.map(bring_summary, stored_runs), strict=True)
        yield from track(brought, "fetching runs", len(stored_runs))


def bring_summary(run: RunInStore) -> Path:
    """A copy of one run's `SUMMARY_FILES`, and of its weights where `bring_summaries` needs them."""
    copy = bring_run(run, SUMMARY_FILES)
    left = read_record(copy).left.get(WEIGHTS)
    if left is not None and not left.sha256 and RESULTS_FILE in run.files:
        return bring_run(run, (*SUMMARY_FILES, WEIGHTS))
    return copy


def send_results(run: Path) -> bool:
    """Where `run` is a copy in the user's cache, add the results that were added to it to those in the store, also
    if other machines have added some meanwhile; True if any were. Raises StoreError."""
    place = location(cached_from(run))
    if not isinstance(place, Url):
        return False  # bc-train copies all of a run of this machine
    with stored_run_folder(place) as folder:
        return folder.upload(only=(RESULTS_FILE,))


def stored_run_folder(url: Url, here: Path | None = None, *, waits: bool = True) -> StoredFolder:
    from common.stored_folder import StoredFolder  # an extra

    return StoredFolder(url, here, waits=waits, line_files=ADDED_TO)


def url_of(name: str | None, runs: Url) -> str | None:
    """The URL of a run in `runs` that is given as NAME or NAME/last; any other argument as it is."""
    first, _, rest = (name or "").partition("/")
    return f"{runs}/{name}" if is_name(first) and rest in ("", "last") else name


def is_name(name: str) -> bool:
    """Whether this is a run's name, and no path."""
    is_plain = PurePosixPath(name).name == name and not set(name) & set("\\:")
    return is_plain and bool(name) and not name.startswith(".")


def _newest(runs: Url) -> RunInStore:
    trained = [run for run in runs_in_store(runs) if run.has_weights]
    if not trained:
        raise RunError(f"{runs}: no trained run in it; train one with `bc-train --runs {runs}`")
    return max(trained, key=lambda run: (run.written_ns, run.name))


def _run_of(url: Url, objects: Iterable[StoredObject]) -> RunInStore:
    return RunInStore(url, {stored.url.name_in(url): stored for stored in objects})
