"""The same pictures in two sessions: in training and in validation, they would make every error look small.

A log may have been imported twice, or trimmed, merged, recovered beside its original. Logs name no ancestors that
could be trusted, so the pictures themselves are compared: those of equal time, camera and length, byte by byte.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dataset.errors import DatasetError
from dataset.frames import read_frames
from dataset.samples import is_excluded
from recorder import Log

_PRIMES: Final = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F))


def refuse_shared_pictures(frames: Mapping[str, Path], logs: Mapping[str, Path]) -> None:
    """Raise DatasetError if two sessions hold the same picture; frames tagged `exclude` do not count.

    `frames` and `logs`: the frames file and the log of each session.
    """
    if len(frames) < 2:
        return
    names = list(frames)
    keys, owners, positions = [], [], []
    for number, name in enumerate(names):
        table = read_frames(frames[name], ("log_time_ns", "length", "tags"))
        at = np.flatnonzero(~is_excluded(table))
        keys.append(_key(table["log_time_ns"].to_numpy(), table["length"].to_numpy())[at])
        owners.append(np.full(len(at), number, np.int32))
        positions.append(at.astype(np.int32))
    key, owner, position = np.concatenate(keys), np.concatenate(owners), np.concatenate(positions)
    order = np.argsort(key, kind="stable")  # and so by owner where keys are equal
    alike = np.flatnonzero((np.diff(key[order]) == 0) & (np.diff(owner[order]) != 0))
    pairs = np.stack([order[alike], order[alike + 1]], axis=1)
    with contextlib.ExitStack() as stack:
        seen: dict[int, _Session] = {}
        for pair in pairs.tolist():
            found = []
            for at in pair:
                number = int(owner[at])
                if number not in seen:
                    log = stack.enter_context(Log(logs[names[number]]))
                    seen[number] = _Session(log, frames[names[number]])
                found.append(seen[number].picture(int(position[at])))
            (row, data), (other_row, other_data) = found
            if data == other_data:
                one, other = (logs[names[int(owner[at])]] for at in pair)
                raise DatasetError(
                    f"{one} and {other}: the same picture in both (rows {row} and {other_row}); index only one of"
                    " them, or tag the rows `exclude` in one: `bc-log tag`"
                )


class _Session:
    """An open log and where its frames are."""

    def __init__(self, log: Log, frames: Path) -> None:
        table = read_frames(frames, ("row", "offset", "length", "chunk"))
        self._log = log
        self._columns = [table[name].to_numpy() for name in ("row", "offset", "length", "chunk")]

    def picture(self, position: int) -> tuple[int, bytes]:
        """Row and bytes of a frame."""
        row, offset, length, chunk = (int(column[position]) for column in self._columns)
        return row, self._log.read(offset, length, chunk)


def _key(time_ns: NDArray[np.int64], length: NDArray[np.int64]) -> NDArray[np.uint64]:
    """One number for time and length; different ones seldom share it, and are then told apart by their bytes."""
    mixed: NDArray[np.uint64] = time_ns.astype(np.uint64) * _PRIMES[0] + length.astype(np.uint64) * _PRIMES[1]
    return mixed
