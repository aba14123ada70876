"""Find the same pictures in two sessions. Shared by training and validation, they would make the errors too small.

A log may have been imported twice, or be trimmed, merged or recovered from another log of the index. The metadata
of a log about its origin cannot be trusted, so pictures of equal time, camera and length are compared byte by
byte.

A deterministic simulator begins all drives with the same pictures of a standing car. A few of these are accepted,
and are not used for validation.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common.car import CAMERAS
from common.location import Location
from common.process_settings import allow_open_files
from common.progress import track
from common.tasks import Tasks, one_by_one
from dataset.errors import DatasetError, SessionError
from dataset.frames.frame_flags import is_excluded
from dataset.frames.frames_file import Extent, read_frames
from recorder import Log, LogError
from recorder.rows.row_quality import STANDING_MPH

_PRIME: Final = np.uint64(0x9E3779B97F4A7C15)

MAX_STANDING_SHARE: Final = 0.25
"""The maximum share of a session's frames that may have a standing car and a picture that another session has.
With a larger share, the session is a duplicate."""


def shared_standing_rows(
    frames: Mapping[str, Path],
    logs: Mapping[str, Location],
    extents: Mapping[str, Extent],
    tasks: Tasks = one_by_one,
) -> dict[str, tuple[int, ...]]:
    """The rows of each session with a standing car whose picture another session has, too.

    `frames`, `logs` and `extents` are the frames file, the log and the times of each session. Only sessions whose
    times overlap are compared: others cannot share pictures. Frames tagged `exclude` do not count.

    Raises DatasetError if two sessions share a picture of a moving car, or if a session shares more than
    `MAX_STANDING_SHARE` of its frames; SessionError if a log is damaged.
    """
    names = _overlapping(extents)
    calls = [(frames[name],) for name in names]
    if not calls:
        return {}
    by_number = dict(track(tasks(_keys, calls), "comparing sessions", len(calls)))
    keys, positions = ([by_number[number][i] for number in range(len(names))] for i in range(2))
    key = np.sort(np.concatenate(keys))
    if not (key[1:] == key[:-1]).any():  # the usual case
        return {}
    owner = np.repeat(np.arange(len(names), dtype=np.int32), [len(session_keys) for session_keys in keys])
    key, position = np.concatenate(keys), np.concatenate(positions)
    order = np.argsort(key, kind="stable")  # stable: equal keys are in the order of the sessions
    equal = np.flatnonzero((np.diff(key[order]) == 0) & (np.diff(owner[order]) != 0))
    # the groups of equal keys of more than one session
    groups = np.unique(np.searchsorted(key[order], key[order][equal]))
    allow_open_files(len(frames))
    standing: dict[int, dict[int, _Pair]] = defaultdict(dict)  # by session, and by position in its frames
    with contextlib.ExitStack() as stack:
        opened: dict[int, _Session] = {}
        for start in groups.tolist():
            end = int(np.searchsorted(key[order], key[order][start], side="right"))
            first_shown: dict[bytes, tuple[int, int]] = {}
            for at in order[start:end].tolist():
                number, place = int(owner[at]), int(position[at])
                if number not in opened:
                    log = stack.enter_context(Log(logs[names[number]]))
                    opened[number] = _Session(log, frames[names[number]])
                try:
                    data = opened[number].picture(place)
                except LogError as error:
                    raise SessionError(names[number], error) from None
                other, other_place = first_shown.setdefault(hashlib.sha256(data).digest(), (number, place))
                if other == number:
                    continue
                pair = opened[other], other_place, opened[number], place
                if not (opened[other].stands(other_place) and opened[number].stands(place)):
                    raise _refused(*pair)
                standing[number][place] = standing[other][other_place] = pair
    for number, pairs in standing.items():
        if len(pairs) > MAX_STANDING_SHARE * extents[names[number]].frames:
            raise _refused(*next(iter(pairs.values())))
    rows = {number: {opened[number].row(place) for place in pairs} for number, pairs in standing.items()}
    return {names[number]: tuple(sorted(rows[number])) for number in sorted(rows)}


def _overlapping(extents: Mapping[str, Extent]) -> list[str]:
    """The sessions whose times overlap with those of another session, in the order of `extents`."""
    overlapping: set[str] = set()
    latest = ""
    for name in sorted(extents, key=lambda name: extents[name].first_ns):
        if not extents[name].frames:
            continue
        if latest and extents[name].first_ns <= extents[latest].last_ns:
            overlapping |= {name, latest}
        if not latest or extents[name].last_ns > extents[latest].last_ns:
            latest = name
    return [name for name in extents if name in overlapping]


def _seed_hint(metadata: Mapping[str, str], other_metadata: Mapping[str, str]) -> str:
    """A hint if both logs are drives in the built-in simulator with the same seed, which differ only in length."""
    names = ("track_fingerprint", "driver", "drive.seed")
    is_same = "drive.seed" in metadata and all(metadata.get(name) == other_metadata.get(name) for name in names)
    if any(name.endswith("_from") for name in (*metadata, *other_metadata)):  # one was trimmed or recovered
        return ""
    return ". Both were driven with the same seed: `bc-record --seed N` gives another drive" if is_same else ""


class _Session:
    def __init__(self, log: Log, frames: Path) -> None:
        table = read_frames(frames, ("row", "offset", "length", "chunk", "speed_mph"))
        self._log = log
        self.path = log.path
        self.metadata = log.metadata
        *self._columns, speed_mph = (column.to_numpy() for column in table.columns)
        self._stands = np.abs(speed_mph) < STANDING_MPH  # False if the speed is unknown

    def picture(self, position: int) -> bytes:
        _, offset, length, chunk = (int(column[position]) for column in self._columns)
        return self._log.read(offset, length, chunk)

    def row(self, position: int) -> int:
        return int(self._columns[0][position])

    def stands(self, position: int) -> bool:
        return bool(self._stands[position])


_Pair = tuple[_Session, int, _Session, int]
"""Two sessions that share a picture, each with its position in the frames."""


def _refused(first: _Session, first_position: int, second: _Session, second_position: int) -> DatasetError:
    return DatasetError(
        f"{first.path} and {second.path}: the same picture in both (rows {first.row(first_position)} and"
        f" {second.row(second_position)}); index only one of them, or tag the rows `exclude` in one: `bc-log tag`"
        f"{_seed_hint(first.metadata, second.metadata)}"
    )


def _keys(file: Path) -> tuple[NDArray[np.uint64], NDArray[np.int32]]:
    """The keys of a session's frames that are not tagged `exclude`, and their positions in the frames file."""
    table = read_frames(file, ("log_time_ns", "length", "camera", "tags"))
    at = np.flatnonzero(~is_excluded(table))
    return picture_keys(table)[at], at.astype(np.int32)


def picture_keys(frames: pa.Table, *numbers: str) -> NDArray[np.uint64]:
    """A hash (N,) of time, length, camera, and the columns `numbers`. Two different pictures may have the same
    hash."""
    camera = pc.index_in(frames["camera"].cast(pa.string()), pa.array(CAMERAS)).to_numpy()
    columns = (frames["log_time_ns"].to_numpy(), frames["length"].to_numpy(), camera)
    columns += tuple(frames[name].to_numpy().view(np.int64) for name in numbers)
    mixed = np.zeros(len(frames), np.uint64)
    for column in columns:
        mixed = mixed * _PRIME + column.astype(np.uint64)
    return mixed
