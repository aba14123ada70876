"""The entries of the list of sessions: a summary of each log, its tags, and its frames in the index."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property, lru_cache
from pathlib import Path

import msgspec
import pyarrow.compute as pc

from common import UserError
from common.errors import printable
from common.files import session_name
from common.untrusted import real_path
from dataset.errors import DatasetError
from dataset.frames.frames_file import read_frames
from dataset.index.build_state import FRAMES_FOLDER, BuildState, read_state, sources_of
from recorder import Log
from recorder.log.tags import Tag, TaggedRows, tags_by_content, tags_path
from recorder.upkeep.log_info import LogInfo, describe
from web.folders.cache_folder import PATIENCE_S, Background, CacheFolder
from web.folders.file_versions import version_of
from web.folders.notes import Note, read_note
from web.folders.project_folders import (
    PLACES,
    Place,
    ProjectFolders,
    is_recording,
    key_of,
    shown_name,
    version_of_log,
)


@dataclass(frozen=True)
class FileTags:
    version: str  # of the file
    tags: list[Tag]  # of this content of the log, in the order of their rows
    stale: int  # tags of an earlier log with this name


class Glance(msgspec.Struct, frozen=True):
    """The part of a log that the cache keeps; not its tags, which change without the log."""

    info: LogInfo
    fingerprint: str


Share = dict[str, int]
"""The frames of a session in the index, by split."""


class IndexState(StrEnum):
    INDEXED = "in the index"
    MISSING = "not in the index"
    CHANGED = "changed since it was indexed"
    LEFT_OUT = "left out"
    PASSED_OVER = "left out by choice"


@dataclass(frozen=True)
class InIndex:
    state: IndexState
    why: str = ""
    frames: dict[str, int] = field(default_factory=dict)  # by split


@dataclass(frozen=True)
class SessionCard:
    """A log in the list. `info` is None until it is read, and if it is unreadable (`problem`)."""

    key: str
    path: Path
    version: str
    info: LogInfo | None
    problem: str
    tags: dict[str, int]  # number of rows by name
    tags_problem: str
    index: InIndex
    is_recording: bool

    @property
    def name(self) -> str:
        return shown_name(self.path)

    @cached_property
    def note(self) -> Note:
        return read_note(self.path)

    @property
    def state(self) -> str:
        """The state in one word: "" for a finished log."""
        if self.problem:
            return "damaged"
        if self.is_recording:
            return "recording"
        return "reading" if self.info is None else "unfinished" if self.info.notice else ""

    @property
    def why(self) -> str:
        """Why it is damaged or unfinished, and what helps; without its path."""
        is_finished = self.info and not self.is_recording  # a growing log needs no recovery
        notice = self.problem or (self.info.notice if self.info and is_finished else "")
        return notice.removeprefix(f"{printable(str(self.path))}: ")

    @cached_property
    def flags(self) -> dict[str, int]:
        """The odd rows of each kind, and the gaps that the recorder did not make on purpose."""
        if self.info is None:
            return {}
        gaps = (self.info.flags or {}).get("gap", 0) - len(self.info.meant_gaps)
        return self.info.odd_rows | ({"gap": gaps} if gaps > 0 else {})

    @property
    def odd_rows(self) -> int:
        return sum(self.info.odd_rows.values()) if self.info else 0  # as `bc-log ls` counts them


class SessionCards:
    """The cards of all logs of a folder. Threads read them, and the cache keeps them."""

    def __init__(self, folders: ProjectFolders, cache: CacheFolder, pool: Executor) -> None:
        self._folders = folders
        self._cache = cache
        self._glances = {place: Background(pool, self._glance) for place in PLACES}
        self._shares = {place: Background(pool, _read_share) for place in PLACES}

    @property
    def done(self) -> int:
        glances, shares = self._glances.values(), self._shares.values()
        return sum(made.done for made in glances) + sum(made.done for made in shares)

    def cards(self, place: Place, patience_s: float | None = PATIENCE_S) -> list[SessionCard]:
        """The cards of all logs in a folder, by name. Those not read within `patience_s` have no `info` yet."""
        logs = self._read(place, patience_s)
        index = self._folders.index
        state = read_state(index)
        frames = {path: index / FRAMES_FOLDER / f"{session_name(path)}.parquet" for path, _, _ in logs}
        indexed = [frames[path] for path in frames if session_name(path) in state.logs]
        shares = self._shares[place].results([(path, version_of(path)) for path in indexed], patience_s)
        return [
            self._card(path, version, glance, self._in_index(path, state, shares.get(frames[path])))
            for path, version, glance in logs
        ]

    def fingerprints(self, place: Place, patience_s: float = PATIENCE_S) -> dict[str, str]:
        """The fingerprint of each log in a folder, by session; "" if it is not read within `patience_s`."""
        return {
            session_name(path): glance.fingerprint if isinstance(glance, Glance) else ""
            for path, _, glance in self._read(place, patience_s)
        }

    def _read(self, place: Place, patience_s: float | None) -> list[tuple[Path, str, Glance | UserError | None]]:
        """Each log of a folder, its version, and what was read of it within `patience_s`."""
        versions = [(path, version_of_log(path)) for path in self._folders.logs(place).values()]
        glances = self._glances[place].results(versions, patience_s)
        return [(path, version, glances.get(path)) for path, version in versions]

    def info(self, path: Path) -> LogInfo:
        return describe(path, with_tags=False)

    def tags(self, path: Path, fingerprint: str) -> FileTags:
        """The tags of this content of a log. Raises LogError for a damaged file."""
        return _file_tags(path, fingerprint, version_of(tags_path(path)))

    def _card(self, path: Path, version: str, glance: Glance | UserError | None, index: InIndex) -> SessionCard:
        problem, tags_problem, tags = "", "", list[Tag]()
        is_growing = is_recording(path)
        if isinstance(glance, UserError):
            # the first rows of a recording may not be on the disk yet
            problem = "" if is_growing else printable(str(glance))
            glance = None
        if glance is not None:
            try:
                tags = self.tags(path, glance.fingerprint).tags
            except UserError as error:
                tags_problem = printable(str(error))
        info = glance.info if glance else None
        if info and info.odd:
            info = dataclasses.replace(info, odd=TaggedRows(tags).untagged(info.odd))
        return SessionCard(
            key=key_of(path),
            path=path,
            version=version,
            info=info,
            problem=problem,
            tags=dict(rows_by_name(tags)),
            tags_problem=tags_problem,
            index=index,
            is_recording=is_growing,
        )

    def _glance(self, path: Path, version: str) -> Glance:
        return self._cache.struct(f"glance 3 {real_path(path)} {version}", Glance, lambda: _read_glance(path))

    def _in_index(self, path: Path, state: BuildState, share: Share | UserError | None) -> InIndex:
        session = session_name(path)
        built = state.logs.get(session)
        if built is None:
            return InIndex(IndexState.PASSED_OVER if session in state.passed_over else IndexState.MISSING)
        if built.sources[0] != str(real_path(path)):
            return InIndex(IndexState.MISSING, "the index has another log of that name")
        sources = sources_of(session, path, self._folders.index)
        if built.sources != sources:
            return InIndex(IndexState.CHANGED, "`bc-index` brings it up to date")
        if not built.fingerprint:
            return InIndex(IndexState.LEFT_OUT, printable(built.notice))
        if isinstance(share, UserError):
            return InIndex(IndexState.INDEXED, printable(str(share)))
        return InIndex(IndexState.INDEXED, "", share or {})


@lru_cache(maxsize=10_000)
def _file_tags(path: Path, fingerprint: str, version: str) -> FileTags:
    by_content = tags_by_content(path)
    tags = sorted(by_content.pop(fingerprint, ()))
    return FileTags(version, tags, sum(map(len, by_content.values())))


def rows_by_name(tags: Sequence[Tag]) -> Counter[str]:
    """The number of rows with each name. `tags` are in the order of their rows, and may overlap."""
    counts, reached = Counter[str](), dict[str, int]()
    for tag in tags:
        first = max(tag.first_row, reached.get(tag.name, -1) + 1)
        counts[tag.name] += max(0, tag.last_row - first + 1)
        reached[tag.name] = max(tag.last_row, reached.get(tag.name, -1))
    return counts


def _read_glance(path: Path) -> Glance:
    with Log(path) as log:
        info = describe(log, with_tags=False, with_kept_lag=False)  # tags and lag change without the log
        info = dataclasses.replace(info, path="", notice=printable(info.notice))  # a path may be invalid text
        return Glance(info, log.fingerprint)


def _read_share(path: Path, version: str) -> Share:
    if not path.is_file():
        raise DatasetError(f"{path}: missing; `bc-index` makes it again")
    split = read_frames(path, ["split"])["split"]
    return {str(pair["values"]): int(pair["counts"]) for pair in pc.value_counts(split).to_pylist()}
