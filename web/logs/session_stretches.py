"""The odd stretches of a log, by its rows and its pictures; the stretches of a filter, and the
search of all logs for rows that meet a condition."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.car import CAMERAS
from common.errors import printable
from common.files import session_name
from common.location import absolute
from common.stretches import stretches
from dataset.config import IndexConfig
from dataset.frames.distinct_rows import paired_rows
from dataset.frames.frame_flags import ImageFindings, Paired, frame_flags
from dataset.frames.frames_file import check_where
from dataset.frames.frames_table import frames_table
from dataset.frames.image_check_cache import check_images, read_image_check, write_image_check
from dataset.index.sessions import name_problem
from recorder import Log, LogError
from recorder.log.findings import findings
from recorder.log.tags import EXCLUDE, FINE, Tag, TaggedRows, read_tags, tags_path
from recorder.rows.causes import CAUSES, NOT_LEARNT, PICTURE_FLAGS, PLAIN
from recorder.rows.condition import lists_with, rows_where
from recorder.rows.odd_stretches import odd_stretches
from recorder.rows.row_quality import States
from recorder.topics import camera_topic
from web.errors import WebError
from web.folders.cache_folder import Background
from web.folders.file_versions import version_of
from web.folders.project_folders import ProjectFolders, version_of_log
from web.logs.open_logs import OpenLog
from web.processes.kept_work import KeptWork, report, run_in_process


class PictureChecks:
    """Checks by a log's fingerprint. One is made at a time, because it uses all processors."""

    def __init__(self, index: Path, cache: Path) -> None:
        self._index = index
        self._kept = cache / "checks"
        self.work = KeptWork(self._kept, "web.logs.session_stretches", "it was stopped")

    def findings(self, log: Log) -> ImageFindings | None:
        """The findings for a log's pictures; None if they were never checked. Findings of earlier versions lack
        the comparison with the steering."""
        indexed = read_image_check(self._index, session_name(log.path), log.fingerprint)
        if indexed is not None and indexed.against is not None:
            return indexed
        return read_image_check(self._kept, log.fingerprint, log.fingerprint) or indexed

    def are_checked(self, log: Log) -> bool:
        """Whether there are findings with the comparison."""
        findings = self.findings(log)
        return findings is not None and findings.against is not None

    def start(self, log: Log) -> None:
        pictures = sum(log.counts.get(camera_topic(camera), 0) for camera in CAMERAS)
        self.work.start(log.fingerprint, pictures, [str(absolute(log.path)), log.fingerprint])


def main() -> None:
    run_in_process(_check)


def _check(path: str, fingerprint: str, result: str) -> None:
    pictures = 0

    def on_decoded(count: int) -> None:
        nonlocal pictures
        pictures += count
        report(pictures=pictures)

    with Log(Path(path)) as log:
        if log.fingerprint != fingerprint:
            raise WebError("the log has been replaced since this page was opened: reload it")
        findings = check_images(log, on_decoded)
    write_image_check(Path(result).parent, fingerprint, fingerprint, findings)


class WhereSearch:
    """The latest condition, with its results so far."""

    def __init__(self, folders: ProjectFolders, pool: Executor) -> None:
        self._folders = folders
        self._pool = pool
        self._lock = threading.Lock()
        self._where = ""
        self._search: Background[int] | None = None

    @property
    def done(self) -> int:
        return self._search.done if self._search else 0

    def rows(self, where: str, logs: Sequence[Path], patience_s: float | None) -> dict[Path, int]:
        """The number of rows that meet the condition in each log that is searched within `patience_s`; 0 for an
        unreadable log. Raises UsageError for an invalid condition."""
        check_where(where)
        with self._lock:
            search = self._search
            if search is None or where != self._where:
                search = Background[int](self._pool, partial(self._count, where))
                self._where, self._search = where, search
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


SURE: Final = "sure"
"""Takes the place of a kind: all rows that are surely odd."""

Rows = tuple[int, int]


class ShownStretch(NamedTuple):
    """Odd rows of a log, by their positions among its rows."""

    kind: str
    first: int
    last: int
    cause: str
    is_sure: bool


def shown_stretches(log: Log, states: States, images: ImageFindings | None) -> list[ShownStretch]:
    """The odd stretches of a log, in order. With the check of the log's pictures, they include frozen and broken
    pictures, and steering that contradicts the pictures.

    A gap is a stretch of two rows: the last row before it and the first row after it. Gaps that the recorder made
    on purpose are left out.
    """
    result = []
    for odd in odd_stretches(states):
        first, last = (int(np.flatnonzero(states.row == row)[0]) for row in (odd.first_row, odd.last_row))
        result.append(ShownStretch(odd.kind, first, last, printable(odd.cause), odd.is_sure))
    meant = found.meant_gaps if (found := findings(log)) else []
    gaps = states.flags["gap"] & ~np.isin(states.row, meant)
    result += [ShownStretch("gap", max(at - 1, 0), at, "", False) for at in np.flatnonzero(gaps).tolist()]
    result += [
        ShownStretch(flag, first, last, "", CAUSES[flag].is_sure)
        for flag, mask in _of_pictures(log, states, images).items()
        for first, last in stretches(mask)
    ]
    return sorted(result, key=lambda stretch: (stretch.first, stretch.last, stretch.kind))


def flag_stretches(states: States) -> dict[str, list[tuple[int, int]]]:
    """The first and last positions of the stretches of each of `PLAIN`."""
    if not len(states.row):
        return {}
    flags = states.flags
    return {flag: stretches(flags[flag]) for flag in PLAIN if flags[flag].any()}


def not_learnt_stretches(states: States) -> list[tuple[int, int]]:
    """The first and last positions of the stretches that training leaves out by default."""
    if not len(states.row):
        return []
    return stretches(np.logical_or.reduce([states.flags[flag] for flag in NOT_LEARNT]))


def _of_pictures(log: Log, states: States, images: ImageFindings | None) -> dict[str, NDArray[np.bool_]]:
    """A mask (N,) of rows for each flag of pictures."""
    paired = {camera: Paired(*paired_rows(log.pictures(camera_topic(camera)), states)) for camera in CAMERAS}
    flags = pa.chunked_array([frame_flags(states, paired, images)])
    row = states.row[np.concatenate([frames.state for frames in paired.values()])]
    return {flag: np.isin(states.row, row[lists_with(flags, flag)]) for flag in PICTURE_FLAGS}


def stretches_of_kind(opened: OpenLog, checks: PictureChecks, kind: str) -> list[Rows]:
    """First and last row of each stretch of a kind or flag, or of all stretches that are surely odd."""
    states = opened.states
    if not len(states.row):
        return []
    if kind in PLAIN:
        return [_rows(states, first, last) for first, last in flag_stretches(states).get(kind, ())]
    return [
        _rows(states, stretch.first, stretch.last)
        for stretch in shown_stretches(opened.log, states, checks.findings(opened.log))
        if (stretch.is_sure if kind == SURE else stretch.kind == kind)
    ]


def stretches_of_rows(opened: OpenLog, rows: set[int]) -> list[Rows]:
    states = opened.states
    return [_rows(states, first, last) for first, last in stretches(np.isin(states.row, list(rows)))]


def not_dealt_with(stretches: list[Rows], tags: list[Tag]) -> list[Rows]:
    """The stretches with a row that is neither excluded nor fine."""
    done = TaggedRows(tag._replace(name=FINE) for tag in tags if tag.name in (EXCLUDE, FINE))
    return [rows for rows in stretches if not done.cover(*rows)]


def _rows(states: States, first: int, last: int) -> Rows:
    low, high = sorted((int(states.row[first]), int(states.row[last])))
    return low, high
