"""Whether validation is honest: what is held out for it must not be, or nearly be, what training sees.

Reads the two parquet files as anybody could, and trusts nothing of what wrote them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dataset.errors import DatasetError
from dataset.frames import read_metadata
from dataset.index import FRAMES_FOLDER, SAMPLES_NAME
from dataset.samples import is_excluded


def find_leaks(index: Path) -> list[str]:
    """What is wrong with the split of `index`; an empty list if nothing is.

    No row of a log may be on both sides (its cameras, mirror images and copies with it); no training sample may
    lie within the gap around a validation sample of the same drive; nothing that is altered, a copy, or tagged
    `exclude` may be validated or used. Raises DatasetError if there is no index, or if it is damaged.
    """
    path = index / SAMPLES_NAME
    metadata = read_metadata(path)
    if metadata is None:
        raise DatasetError(f"{path}: no index, or a damaged one; build it with `bc-index`")
    found: list[str] = []
    try:
        gap_s = float(metadata["settings"]["gap_s"])
        samples = pq.read_table(path, columns=["session", "row", "split", "copy", "alteration"])
        for session in sorted(metadata["logs"]):
            frames = pq.read_table(index / FRAMES_FOLDER / f"{session}.parquet")
            mine = samples.filter(pa.compute.equal(samples["session"], session))
            found += [f"{session}: {what}" for what in _leaks_of(mine, frames, gap_s)]
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException) as error:
        raise DatasetError(f"{index}: damaged ({error}); remove it and build it again with `bc-index`") from None
    return found


def _leaks_of(samples: pa.Table, frames: pa.Table, gap_s: float) -> list[str]:
    row = samples["row"].to_numpy()
    is_validation = pa.compute.equal(samples["split"], "validation").to_numpy()
    training, validation = np.unique(row[~is_validation]), np.unique(row[is_validation])
    found = []
    if len(both := np.intersect1d(training, validation)):
        found.append(f"{len(both):,} rows are in training and in validation, the first is row {both[0]}")
    is_altered = pa.compute.not_equal(samples["alteration"], "").to_numpy() | samples["copy"].to_numpy()
    if altered := int((is_altered & is_validation).sum()):
        found.append(f"{altered:,} samples of validation are altered or copies")
    excluded = np.unique(frames["row"].to_numpy()[is_excluded(frames)])
    if len(used := np.intersect1d(excluded, row)):
        found.append(f"{len(used):,} rows are tagged `exclude` and used, the first is row {used[0]}")
    if close := _close(frames, training, validation, gap_s):
        found.append(close)
    return found


def _close(frames: pa.Table, training: NDArray[Any], validation: NDArray[Any], gap_s: float) -> str:
    """The training row that is nearest in time to a validation row of its drive, if it is within the gap."""
    row, at = np.unique(frames["row"].to_numpy(), return_index=True)
    time_ns, drive = frames["log_time_ns"].to_numpy()[at], frames["drive"].to_numpy()[at]
    nearest_s, where = np.inf, ""
    for number in np.unique(drive):
        inside = drive == number
        one, other = (inside & np.isin(row, rows) for rows in (training, validation))
        if not one.any() or not other.any():
            continue
        held_out = np.sort(time_ns[other])
        right = np.minimum(np.searchsorted(held_out, time_ns[one]), len(held_out) - 1)
        left = np.maximum(right - 1, 0)
        apart_s = np.minimum(abs(held_out[right] - time_ns[one]), abs(held_out[left] - time_ns[one])) / 1e9
        if apart_s.min() < nearest_s:
            nearest_s, where = float(apart_s.min()), f"row {row[one][apart_s.argmin()]}"
    if nearest_s > gap_s or (gap_s == 0 and nearest_s > 0):
        return ""
    return f"training {where} is {nearest_s:.2f} s from validation, less than the gap of {gap_s:g} s"
