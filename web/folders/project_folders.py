"""The folders that the workbench shows, on this machine or in stores. Names in addresses are looked up in
listings, never joined to a path.

Sizes, times and versions of logs come from the file system or from the store's last listing. No log is read.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final, Literal, get_args

from common.errors import StoreError, printable
from common.files import PART_SUFFIX
from common.location import Location, Url
from common.locks import is_being_written
from dataset.index.build_state import Stat, stat_of
from model.runs.run_files import CONFIG
from recorder.log.logs_in_folder import logs_in
from web.errors import WebError, or_404
from web.folders.file_versions import version_of, version_of_folder, version_of_growing, version_of_stats
from web.folders.stored_folders import StoredCopy, StoredRuns, StoreListings

Place = Literal["sessions", "drives"]
"""A folder of logs, as addresses name it."""
PLACES: Final[tuple[Place, ...]] = get_args(Place)

_PLAIN: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
_LOG: Final = ".mcap"


@dataclass(frozen=True)
class ProjectFolders:
    """The folders that the commands write to. They need not exist yet."""

    sessions: Location = Path("sessions")
    index: Location = Path("index")
    runs: Location = Path("runs")
    drives: Location = Path("drives")
    _listed: dict[tuple[Place, str], Location] = field(default_factory=dict, init=False, repr=False)
    _listings: StoreListings = field(default_factory=StoreListings, init=False, repr=False, compare=False)

    @property
    def _all(self) -> list[Location]:
        return [self.sessions, self.index, self.runs, self.drives]

    @property
    def are_in_stores(self) -> bool:
        """Whether any of them is in a store."""
        return any(isinstance(folder, Url) for folder in self._all)

    @property
    def are_new(self) -> bool:
        """True while none of them exists."""
        return not any(isinstance(folder, Url) or folder.exists() for folder in self._all)

    @property
    def parent(self) -> Path | None:
        """The folder that has all of them under their usual names; None if they are elsewhere."""
        if isinstance(self.sessions, Url):
            return None
        parent = self.sessions.parent
        usual = [parent / name for name in ("sessions", "index", "runs", "drives")]
        return parent if self._all == usual else None

    def flags(self, *names: str, to_store: str = "") -> list[str]:
        """The flags that name these folders for a command; none for the usual folders. `to_store` is the flag for
        a folder in a store, if the command has another one."""
        return [
            f"{to_store if to_store and isinstance(folder, Url) else f'--{name}'}={folder}"
            for name in names
            if (folder := getattr(self, name)) != getattr(ProjectFolders, name)
        ]

    @property
    def recordings(self) -> Path:
        """The folder of recordings that browsers have uploaded."""
        return (Path() if isinstance(self.sessions, Url) else self.sessions.parent) / "recordings"

    @cached_property
    def _index_copy(self) -> StoredCopy | None:
        return StoredCopy(self.index) if isinstance(self.index, Url) else None

    @property
    def local_index(self) -> Path:
        """The index, or its copy on this machine."""
        return self.index if isinstance(self.index, Path) else self._index_copy.folder  # type: ignore[union-attr]

    def refresh_index(self) -> str:
        """Fetch the changes of an index in a store. Return the problem if that fails, else ""."""
        if self._index_copy is None:
            return ""
        self._index_copy.refresh()
        return self._index_copy.problem

    def logs(self, place: Place) -> dict[str, Location]:
        """The logs of a folder by their keys in addresses; {} without a folder."""
        folder: Location = getattr(self, place)
        if isinstance(folder, Path):
            return {key_of(path): path for path in logs_in(folder)}
        self.refresh(place)
        return {key_of(url): url for url in self._listings.objects(folder) if url.suffix == _LOG}

    def refresh(self, place: Place) -> None:
        """List a folder in a store again, if the last listing is some seconds old."""
        folder: Location = getattr(self, place)
        if isinstance(folder, Url):
            self._listings.of(folder).refresh()

    def problem(self, place: Place) -> str:
        """Why a folder's store does not answer, so that the list may be outdated; else ""."""
        folder: Location = getattr(self, place)
        return self._listings.of(folder).problem if isinstance(folder, Url) else ""

    def finished(self, place: Place) -> dict[str, str]:
        """The names of a folder's finished logs for people, by their keys."""
        return {key: shown_name(log) for key, log in self.logs(place).items() if log.suffix == _LOG}

    def log(self, place: Place, key: str) -> Location:
        """The log of a key. Raises WebError if it does not exist (any more), or if its store does not answer."""
        listed = self._listed.get((place, key))
        if listed is not None and self._still_exists(listed):  # a thousand logs are not listed for each picture
            return listed
        log = self.logs(place).get(key)
        if log is None:
            if problem := self.problem(place):
                raise WebError(problem, 503)
            folder = getattr(self, place)
            raise WebError(f"{folder}: no log {key!r} in it; it may have been deleted, renamed or moved", 404)
        self._listed[place, key] = log
        return log

    def _still_exists(self, log: Location) -> bool:
        return log.is_file() if isinstance(log, Path) else self._listings.find(log) is not None

    def stat(self, place: Location) -> Stat:
        """Size, and time of modification or ETag, of a log or a file next to it; None without a file."""
        if isinstance(place, Path):
            return stat_of(place)
        stored = self._listings.find(place)
        return None if stored is None else (stored.size, stored.version)

    def is_taken(self, log: Location) -> bool:
        """Whether any file or link has that name."""
        return (log.exists() or log.is_symlink()) if isinstance(log, Path) else self.stat(log) is not None

    def refresh_object(self, place: Location) -> None:
        """Refresh the listing of an object in a store that a page has changed."""
        if isinstance(place, Url):
            self._listings.refresh_object(place)

    def version_of(self, place: Location) -> str:
        """The version of a log or its tags: it changes when the file is written, replaced or removed."""
        return version_of(place) if isinstance(place, Path) else version_of_stats([(place, self.stat(place))])

    def version_of_log(self, place: Location) -> str:
        """The version of a log for lists. While the log is recorded, it changes less often."""
        if isinstance(place, Path) and place.name.endswith(PART_SUFFIX):
            return version_of_growing(place)
        return self.version_of(place)

    def version_of_folder(self, place: Place) -> str:
        """The version of a folder's logs and tags."""
        folder: Location = getattr(self, place)
        if isinstance(folder, Path):
            return version_of_folder(folder)
        self.refresh(place)
        objects = self._listings.objects(folder)
        return version_of_stats((url, self.stat(url)) for url in objects) + self.problem(place)

    def refuse_unanswered(self, log: Location) -> None:
        """Raise StoreError for a log whose store did not answer the last request."""
        if isinstance(log, Url) and (problem := self._listings.of(log.parent).problem):
            raise StoreError(problem)

    @cached_property
    def _stored_runs(self) -> StoredRuns | None:
        return StoredRuns(self.runs) if isinstance(self.runs, Url) else None

    @property
    def runs_problem(self) -> str:
        """Why the store of the runs does not answer, so that the list may be outdated; else ""."""
        return self._stored_runs.problem if self._stored_runs else ""

    def run_folders(self) -> dict[str, Path]:
        """The folders of the runs, also unreadable ones, by their keys in addresses. For a run in a store, it is
        the folder with the copies of its small files."""
        if self._stored_runs:
            self._stored_runs.refresh()
            return {key_of(path): path for path in self._stored_runs.runs()}
        assert isinstance(self.runs, Path)  # noqa: S101
        return {key_of(path.parent): path.parent for path in sorted(self.runs.glob(f"*/{CONFIG}"))}

    def run(self, key: str) -> Path:
        """The run of a key. Raises WebError if it does not exist (any more)."""
        path = self.run_folders().get(key)
        if path is None and self.runs_problem:
            raise WebError(self.runs_problem, 503)
        return or_404(path, f"{self.runs}: no run {key!r} in it; it may have been deleted, renamed or moved")

    def run_place(self, run: Path) -> Location:
        """The original location of a run; `run` may be a copy."""
        return (self._stored_runs and self._stored_runs.url(run)) or run

    def version_of_run(self, run: Path, names: Sequence[str]) -> str:
        """The version of some of a run's files."""
        if self._stored_runs:
            return self._stored_runs.version(run, names)
        return version_of(*(run / name for name in names))

    def bring_run(self, run: Path, names: Sequence[str]) -> None:
        """Fetch these files of a run if they have changed in its store. Raises StoreError."""
        if self._stored_runs:
            self._stored_runs.bring(run, names)


def shown_name(log: Location) -> str:
    """The name of a log as pages show it."""
    return printable(log.name.removesuffix(_LOG))


def is_recording(log: Location) -> bool:
    """Whether a log is being recorded now."""
    return log.name.endswith(PART_SUFFIX) and is_being_written(log)


def as_word(log: Location) -> str:
    """A log as an argument of a process that may run in another folder."""
    return str(log.absolute() if isinstance(log, Path) else log)


def key_of(path: Location) -> str:
    """The key of a file or folder in addresses: its name without .mcap if that is plain, else its hash. Names may
    be invalid text."""
    name = path.name.removesuffix(_LOG)
    if _PLAIN.fullmatch(name):
        return name
    return "~" + hashlib.sha256(path.name.encode(errors="surrogatepass")).hexdigest()[:20]
