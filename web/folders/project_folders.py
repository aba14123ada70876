"""The folders that the workbench shows, on this machine or in stores. Names in addresses are looked up in
listings, never joined to a path.

What pages know of a log without reading it comes from here: for one of this machine from its file system, for one
in a store from a listing of its folder, which is asked for seldom.
"""

from __future__ import annotations

import hashlib
import os
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
from recorder.log.tags import tags_path
from web.errors import WebError
from web.folders.file_versions import version_of, version_of_folder, version_of_growing, version_of_stats
from web.folders.stored_folders import StoredCopy, StoreListings
from web.folders.stored_runs import StoredRuns

Place = Literal["sessions", "drives"]
"""A folder of logs, as addresses name it."""
PLACES: Final[tuple[Place, ...]] = get_args(Place)

_PLAIN: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
_LOG: Final = ".mcap"


@dataclass(frozen=True)
class ProjectFolders:
    """The folders that the commands write to; none of them need be there yet."""

    sessions: Location = Path("sessions")
    index: Location = Path("index")
    runs: Location = Path("runs")
    drives: Location = Path("drives")
    _found: dict[tuple[Place, str], Location] = field(default_factory=dict, init=False, repr=False)  # by a listing
    _listings: StoreListings = field(default_factory=StoreListings, init=False, repr=False, compare=False)

    @property
    def are_in_stores(self) -> bool:
        """True if any of them is."""
        return any(isinstance(folder, Url) for folder in (self.sessions, self.index, self.runs, self.drives))

    @property
    def are_new(self) -> bool:
        """True while none of them is there."""
        every = (self.sessions, self.index, self.runs, self.drives)
        return not any(isinstance(folder, Url) or folder.exists() for folder in every)

    @property
    def parent(self) -> Path | None:
        """The folder that all of them are in by their usual names; None if they are elsewhere."""
        if isinstance(self.sessions, Url):
            return None
        parent = self.sessions.parent
        usual = (parent / name for name in ("sessions", "index", "runs", "drives"))
        return parent if (self.sessions, self.index, self.runs, self.drives) == tuple(usual) else None

    def flags(self, *names: str, to_store: str = "") -> list[str]:
        """The flags that tell a command these folders, where they are not the usual ones. `to_store`: the flag for
        one in a store, if that is another."""
        return [
            f"{to_store if to_store and isinstance(folder, Url) else f'--{name}'}={folder}"
            for name in names
            if (folder := getattr(self, name)) != getattr(ProjectFolders, name)
        ]

    @property
    def recordings(self) -> Path:
        """The folder of recordings that a browser has sent, to be imported."""
        return (Path() if isinstance(self.sessions, Url) else self.sessions.parent) / "recordings"

    @cached_property
    def _index_copy(self) -> StoredCopy | None:
        return StoredCopy(self.index) if isinstance(self.index, Url) else None

    @property
    def index_here(self) -> Path:
        """The index, or the copy of it that pages read."""
        return self.index if isinstance(self.index, Path) else self._index_copy.here  # type: ignore[union-attr]

    def refresh_index(self) -> str:
        """Fetch what has changed of an index in a store; returns the problem if that fails, else ""."""
        if self._index_copy is None:
            return ""
        self._index_copy.refresh()
        return self._index_copy.problem

    def logs(self, place: Place) -> dict[str, Location]:
        """The logs of a folder by the key that they have in addresses; {} where there is no such folder."""
        folder: Location = getattr(self, place)
        if isinstance(folder, Path):
            return {key_of(path): path for path in logs_in(folder)}
        self.refresh(place)
        return {key_of(url): url for url in self._listings.objects(folder) if url.suffix == _LOG}

    def refresh(self, place: Place) -> None:
        """List a folder in a store anew, if the last time is some seconds ago."""
        folder: Location = getattr(self, place)
        if isinstance(folder, Url):
            self._listings.refresh(folder)

    def problem(self, place: Place) -> str:
        """The problem of a folder's store, if what is shown may be outdated: it does not answer, or refuses."""
        folder: Location = getattr(self, place)
        return self._listings.problem(folder) if isinstance(folder, Url) else ""

    def finished(self, place: Place) -> dict[str, str]:
        """The names of a folder's finished logs for people, by their keys."""
        return {key: shown_name(log) for key, log in self.logs(place).items() if log.suffix == _LOG}

    def log(self, place: Place, key: str) -> Location:
        """The log of that key. Raises WebError if it is not there (any more), or if its store does not answer."""
        known = self._found.get((place, key))
        if known is not None and self._is_there(known):  # a thousand logs are not listed for each picture
            return known
        found = self.logs(place).get(key)
        if found is None:
            if problem := self.problem(place):
                raise WebError(problem, 503)
            folder = getattr(self, place)
            raise WebError(f"{folder}: no log {key!r} in it; it may have been deleted, renamed or moved", 404)
        self._found[place, key] = found
        return found

    def _is_there(self, log: Location) -> bool:
        return log.is_file() if isinstance(log, Path) else self._listings.find(log) is not None

    def stat(self, place: Location) -> Stat:
        """Size, and time of modification or ETag, of a log or what lies beside it; None where there is none."""
        if isinstance(place, Path):
            return stat_of(place)
        found = self._listings.find(place)
        return None if found is None else (found.size, found.version)

    def is_there(self, log: Location) -> bool:
        """Whether a file, or anything else, has that name."""
        return (log.exists() or log.is_symlink()) if isinstance(log, Path) else self.stat(log) is not None

    def refresh_object(self, place: Location) -> None:
        """Refresh the listing of an object in a store that was changed from here."""
        if isinstance(place, Url):
            self._listings.refresh_object(place)

    def version_of(self, place: Location) -> str:
        """The version of a log or its tags: it changes when the file is written to, replaced, or removed."""
        return version_of(place) if isinstance(place, Path) else version_of_stats([(place, self.stat(place))])

    def version_of_log(self, place: Location) -> str:
        """The version of a log for lists: that of one that is being recorded changes less often."""
        if isinstance(place, Path) and place.name.endswith(PART_SUFFIX):
            return version_of_growing(place)
        return self.version_of(place)

    def version_of_folder(self, place: Place) -> str:
        """The version of a folder's logs and tags. No file is read; a store is listed now and then."""
        folder: Location = getattr(self, place)
        if isinstance(folder, Path):
            return version_of_folder(folder)
        self.refresh(place)
        objects = self._listings.objects(folder)
        return version_of_stats((url, self.stat(url)) for url in objects) + self.problem(place)

    def refuse_unanswered(self, log: Location) -> None:
        """Raise StoreError, at once, for a log whose store has not answered when it was last asked."""
        if isinstance(log, Url) and (problem := self._listings.problem(log.parent)):
            raise StoreError(problem)

    def has_tags(self, log: Location) -> bool:
        """False for a log in a store with no tags beside it, which need not be fetched."""
        return isinstance(log, Path) or self.stat(tags_path(log)) is not None

    @cached_property
    def _stored_runs(self) -> StoredRuns | None:
        return StoredRuns(self.runs) if isinstance(self.runs, Url) else None

    @property
    def runs_problem(self) -> str:
        """The problem of the runs' store, if what is shown may be outdated: it does not answer, or refuses."""
        return self._stored_runs.problem if self._stored_runs else ""

    def run_folders(self) -> dict[str, Path]:
        """The runs by the key that they have in addresses, also those that cannot be read; of one in a store, the
        folder that its small files were brought to."""
        if self._stored_runs:
            self._stored_runs.refresh()
            return {key_of(path): path for path in self._stored_runs.runs()}
        assert isinstance(self.runs, Path)  # noqa: S101
        return {key_of(path.parent): path.parent for path in sorted(self.runs.glob(f"*/{CONFIG}"))}

    def run(self, key: str) -> Path:
        """The run of that key. Raises WebError if it is not there (any more)."""
        path = self.run_folders().get(key)
        if path is None:
            if self.runs_problem:
                raise WebError(self.runs_problem, 503)
            raise WebError(f"{self.runs}: no run {key!r} in it; it may have been deleted, renamed or moved", 404)
        return path

    def run_place(self, run: Path) -> Location:
        """The location of a run, by its folder here."""
        return (self._stored_runs and self._stored_runs.url(run)) or run

    def version_of_run(self, run: Path, names: Sequence[str]) -> str:
        """The version of some of a run's files."""
        if self._stored_runs:
            return self._stored_runs.version(run, names)
        return version_of(*(run / name for name in names))

    def bring_run(self, run: Path, names: Sequence[str]) -> None:
        """Fetch those of these files of a run that have changed in its store. Raises StoreError."""
        if self._stored_runs:
            self._stored_runs.bring(run, names)


def shown_name(log: Location) -> str:
    """The name of a log for people."""
    return printable(log.name.removesuffix(_LOG))


def is_recording(log: Location) -> bool:
    """Whether a log is being written now."""
    return log.name.endswith(PART_SUFFIX) and is_being_written(log)


def as_word(log: Location) -> str:
    """A log in the command line of a process that may work in another folder."""
    return str(log.absolute() if isinstance(log, Path) else log)


def key_of(path: Location) -> str:
    """The key of a file or folder in addresses: its name (without .mcap) where that is plain, else a hash of it,
    because a name may hold whatever a file system takes, even bytes that are no text."""
    name = path.name.removesuffix(_LOG)
    if _PLAIN.fullmatch(name):
        return name
    return "~" + hashlib.sha256(os.fsencode(path.name)).hexdigest()[:20]
