"""Runs in a store: list them, and copy them to the user's cache. Only new files are downloaded.

Needs no PyTorch. One request lists a thousand objects of a folder of runs. `send_results` uploads results that
were added to a copy.
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
"""The files that the summary of a run needs: a few kilobytes."""

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
        """True if the run has finished an epoch."""
        return WEIGHTS in self.files

    @property
    def written_ns(self) -> int:
        """Nanoseconds since 1970 at which the weights (or, before the first weights, the config) were written."""
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
    """Find a run by URL, or by name if `runs` is in a store. Without a name: the run with the newest weights.
    Returns None for a run on this machine.

    Raises RunError, which names the runs in the store, if the run does not exist; StoreError if the store fails.
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
    """Copy a listed run to the user's cache, or only the files `wanted`. Returns the copy's folder. `progress`
    gets a line during the download. Raises StoreError."""
    with stored_run_folder(run.url) as folder:
        folder.download(objects=run.files.values(), wanted=wanted, progress=progress)
        return folder.local.absolute()


def bring_summaries(runs: Url) -> Iterator[tuple[RunInStore, Path]]:
    """All runs in a folder, by name, each with a copy of its `SUMMARY_FILES`. Only files that have changed are
    downloaded. A bar counts the runs.

    The weights are downloaded too if the store has no checksum of them: results belong to weights by their
    checksum. Raises StoreError.
    """
    stored_runs = runs_in_store(runs)
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        copies = zip(stored_runs, pool.map(bring_summary, stored_runs), strict=True)
        yield from track(copies, "fetching runs", len(stored_runs))


def bring_summary(run: RunInStore) -> Path:
    """Copy one run's `SUMMARY_FILES`, and its weights if `bring_summaries` needs them. Returns the copy's
    folder."""
    copy = bring_run(run, SUMMARY_FILES)
    left = read_record(copy).left.get(WEIGHTS)
    if left is not None and not left.sha256 and RESULTS_FILE in run.files:
        return bring_run(run, (*SUMMARY_FILES, WEIGHTS))
    return copy


def send_results(run: Path) -> bool:
    """If `run` is a copy in the user's cache, add its new results to those in the store, which other machines may
    have changed meanwhile. Returns True if it added any. Raises StoreError."""
    place = location(cached_from(run))
    if not isinstance(place, Url):
        return False  # bc-train copies a run on this machine as a whole
    with stored_run_folder(place) as folder:
        return folder.upload(only=(RESULTS_FILE,))


def stored_run_folder(url: Url, here: Path | None = None, *, waits: bool = True) -> StoredFolder:
    from common.stored_folder import StoredFolder  # an extra

    return StoredFolder(url, here, waits=waits, line_files=ADDED_TO)


def url_of(name: str | None, runs: Url) -> str | None:
    """The URL of a run in `runs` that is given as NAME or NAME/last; other arguments unchanged."""
    first, _, rest = (name or "").partition("/")
    return f"{runs}/{name}" if is_name(first) and rest in ("", "last") else name


def is_name(name: str) -> bool:
    """True for a run's name, False for a path."""
    is_plain = PurePosixPath(name).name == name and not set(name) & set("\\:")
    return is_plain and bool(name) and not name.startswith(".")


def _newest(runs: Url) -> RunInStore:
    trained = [run for run in runs_in_store(runs) if run.has_weights]
    if not trained:
        raise RunError(f"{runs}: no trained run in it; train one with `bc-train --runs {runs}`")
    return max(trained, key=lambda run: (run.written_ns, run.name))


def _run_of(url: Url, objects: Iterable[StoredObject]) -> RunInStore:
    return RunInStore(url, {stored.url.name_in(url): stored for stored in objects})
