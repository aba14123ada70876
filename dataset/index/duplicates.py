"""The same pictures in two sessions: in training and in validation, they would make every error look small.

A log may have been imported twice, or trimmed, merged, recovered beside its original. Logs name no ancestors that
could be trusted, so the pictures themselves are compared: those of equal time, camera and length, byte by byte.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common.car import CAMERAS
from common.location import Location
from common.open_file_limit import allow_open_files
from common.progress import track
from common.tasks import Tasks, one_by_one
from dataset.errors import DatasetError
from dataset.frames.frame_flags import is_excluded
from dataset.frames.frames_file import Extent, read_frames
from recorder import Log, LogError
from recorder.log.chunk_cache import default_cache

_PRIME: Final = np.uint64(0x9E3779B97F4A7C15)


def refuse_shared_pictures(
    frames: Mapping[str, Path],
    logs: Mapping[str, Location],
    extents: Mapping[str, Extent],
    tasks: Tasks = one_by_one,
) -> None:
    """Raise DatasetError if two sessions hold the same picture; frames tagged `exclude` do not count. Raises
    UnreadablePictureError for a damaged log.

    `frames`, `logs` and `extents`: the frames file, the log and the times of each session. Pictures are compared
    of sessions whose times overlap; others share none.
    """
    names = _overlapping(extents)
    calls = [(frames[name],) for name in names]
    if not calls:
        return
    found = dict(track(tasks(_keys, calls), "comparing sessions", len(calls)))
    keys, positions = ([found[number][i] for number in range(len(names))] for i in range(2))
    key = np.sort(np.concatenate(keys))
    if not (key[1:] == key[:-1]).any():  # as nearly always
        return
    owner = np.repeat(np.arange(len(names), dtype=np.int32), [len(of_session) for of_session in keys])
    key, position = np.concatenate(keys), np.concatenate(positions)
    order = np.argsort(key, kind="stable")  # and so by owner where keys are equal
    alike = np.flatnonzero((np.diff(key[order]) == 0) & (np.diff(owner[order]) != 0))
    # the groups of equal keys in which several sessions have a part
    groups = np.unique(np.searchsorted(key[order], key[order][alike]))
    allow_open_files(len(frames))
    with contextlib.ExitStack() as stack:
        opened: dict[int, _Session] = {}
        for start in groups.tolist():
            end = int(np.searchsorted(key[order], key[order][start], side="right"))
            first_shown: dict[bytes, tuple[int, int]] = {}
            for at in order[start:end].tolist():
                number = int(owner[at])
                if number not in opened:
                    log = stack.enter_context(Log(logs[names[number]], cache=default_cache()))
                    opened[number] = _Session(log, frames[names[number]])
                try:
                    row, data = opened[number].picture(int(position[at]))
                except LogError as error:
                    raise UnreadablePictureError(error, names[number]) from None
                other, other_row = first_shown.setdefault(hashlib.sha256(data).digest(), (number, row))
                if other != number:
                    one, two = logs[names[other]], logs[names[number]]
                    raise DatasetError(
                        f"{one} and {two}: the same picture in both (rows {other_row} and {row}); index only one"
                        " of them, or tag the rows `exclude` in one: `bc-log tag`"
                        f"{_why_alike(opened[other].driven, opened[number].driven)}"
                    )


def _overlapping(extents: Mapping[str, Extent]) -> list[str]:
    """The sessions during which there was another one, in their order."""
    found: set[str] = set()
    latest = ""
    for name in sorted(extents, key=lambda name: extents[name].first_ns):
        if not extents[name].frames:
            continue
        if latest and extents[name].first_ns <= extents[latest].last_ns:
            found |= {name, latest}
        if not latest or extents[name].last_ns > extents[latest].last_ns:
            latest = name
    return [name for name in extents if name in found]


def _why_alike(one: Mapping[str, str], two: Mapping[str, str]) -> str:
    """A hint where the built-in simulator was driven twice with one seed: nothing differs but the length."""
    names = ("track_fingerprint", "driver", "drive.seed")
    is_one_drive = "drive.seed" in one and all(one.get(name) == two.get(name) for name in names)
    if any(name.endswith("_from") for name in (*one, *two)):  # trimmed, recovered: one is made of the other
        return ""
    return ". Both were driven with one seed: `bc-record --seed N` drives otherwise" if is_one_drive else ""


class UnreadablePictureError(LogError):
    """A log of which a picture cannot be read that may be in another one, too."""

    def __init__(self, error: LogError, session: str) -> None:
        super().__init__(str(error))
        self.session = session


class _Session:
    """An open log and where its frames are."""

    def __init__(self, log: Log, frames: Path) -> None:
        table = read_frames(frames, ("row", "offset", "length", "chunk"))
        self._log = log
        self.driven = log.metadata
        self._columns = [table[name].to_numpy() for name in ("row", "offset", "length", "chunk")]

    def picture(self, position: int) -> tuple[int, bytes]:
        """Row and bytes of a frame."""
        row, offset, length, chunk = (int(column[position]) for column in self._columns)
        return row, self._log.read(offset, length, chunk)


def _keys(file: Path) -> tuple[NDArray[np.uint64], NDArray[np.int32]]:
    """The keys of a session's frames that are not tagged `exclude`, and their positions in its file."""
    table = read_frames(file, ("log_time_ns", "length", "camera", "tags"))
    at = np.flatnonzero(~is_excluded(table))
    return _key(table)[at], at.astype(np.int32)


def _key(frames: pa.Table) -> NDArray[np.uint64]:
    """One number for time, length and camera; different ones seldom share it: their bytes tell them apart."""
    camera = pc.index_in(frames["camera"].cast(pa.string()), pa.array(CAMERAS)).to_numpy()
    columns = (frames["log_time_ns"].to_numpy(), frames["length"].to_numpy(), camera)
    mixed = np.zeros(len(frames), np.uint64)
    for column in columns:
        mixed = mixed * _PRIME + column.astype(np.uint64)
    return mixed
