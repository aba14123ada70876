"""The same pictures in two sessions: in training and in validation, they would make every error look small.

A log may have been imported twice, or trimmed, merged, recovered beside its original. Logs name no ancestors that
could be trusted, so the pictures themselves are compared: those of equal time, camera and length, byte by byte.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from dataset.errors import DatasetError
from dataset.samples import is_excluded
from recorder import Log


def refuse_shared_pictures(frames: pa.Table, logs: Mapping[str, Path]) -> None:
    """Raise DatasetError if two sessions hold the same picture; frames tagged `exclude` do not count."""
    frames = frames.filter(pc.invert(is_excluded(frames))).combine_chunks()
    session = frames["session"].combine_chunks().dictionary_encode()
    columns = [
        frames["log_time_ns"].to_numpy(),
        frames["length"].to_numpy(),
        frames["camera"].combine_chunks().dictionary_encode().indices.to_numpy(),
        session.indices.to_numpy(),
    ]
    order = np.lexsort(columns[::-1])
    time_ns, length, camera, owner = (column[order] for column in columns)
    alike = (np.diff(time_ns) == 0) & (np.diff(length) == 0) & (np.diff(camera) == 0) & (np.diff(owner) != 0)
    with contextlib.ExitStack() as stack:
        opened: dict[str, Log] = {}
        for at in np.flatnonzero(alike).tolist():
            pair = frames.take(pa.array(order[at : at + 2])).to_pylist()
            for row in pair:
                if row["session"] not in opened:
                    opened[row["session"]] = stack.enter_context(Log(logs[row["session"]]))
            first, second = (
                opened[row["session"]].read(row["offset"], row["length"], row["chunk"]) for row in pair
            )
            if first == second:
                one, other = (opened[row["session"]].path for row in pair)
                raise DatasetError(
                    f"{one} and {other}: the same picture in both (rows {pair[0]['row']} and {pair[1]['row']});"
                    " index only one of them, or tag the rows `exclude` in one: `bc-log tag`"
                )
