"""Check an index for leaks: training must not use validation pictures, nor their neighbours within the gap.

The check reads the parquet files, and relies only on what the logs hold, such as the rows and times of the frames;
it computes all other values again. (Pictures that two sessions share are found when an index is built.)
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from common.errors import counted
from dataset.errors import DatasetError
from dataset.frames.distinct_rows import by_session, moments
from dataset.frames.frame_flags import is_excluded
from dataset.index.build_state import FRAMES_FOLDER
from dataset.index.duplicates import picture_keys
from dataset.parquet_file import read_columns, read_metadata
from dataset.samples.samples_format import SAMPLES_NAME
from recorder.rows.row_quality import STANDING_MPH

_OF_FRAMES: Final = ["row", "log_time_ns", "tags", "camera", "length", "steering", "speed_mph"]


def find_leaks(index: Path | str) -> list[str]:
    """One line for each error in the split of `index`; an empty list if the split is correct.

    - A row of a log, with its cameras, mirror images and copies, must not be in both training and validation.
    - A training sample must not be within the gap around a validation sample of its session.
    - A log may hold a drive twice: a picture must not be in both under two rows, unless the car stands.
    - Validation must not contain altered pictures or copies, and no sample may be tagged `exclude`.

    Raises DatasetError if the index is missing or damaged.
    """
    index = Path(index)
    path = index / SAMPLES_NAME
    metadata = read_metadata(path) or {}
    try:
        return _leaks_in(path, index, float(metadata["settings"]["gap_s"]))
    except (OSError, LookupError, TypeError, ValueError, pa.ArrowException) as error:
        raise DatasetError(f"{path}: no index, or a damaged one ({error}); build it with `bc-index`") from None


def _leaks_in(path: Path, index: Path, gap_s: float) -> list[str]:
    columns = ["session", "row", "log_time_ns", "split", "copy", "alteration"]
    samples = read_columns(path, columns, read_dictionary=["session"]).unify_dictionaries()
    leaks: list[str] = []
    for name, session_samples in by_session(samples):
        frames = pq.read_table(index / FRAMES_FOLDER / f"{name}.parquet", columns=_OF_FRAMES)
        leaks += [f"{name}: {leak}" for leak in _leaks_of(session_samples, frames, gap_s)]
    return leaks


def _leaks_of(samples: pa.Table, frames: pa.Table, gap_s: float) -> list[str]:
    is_validation = pc.equal(samples["split"], "validation").to_numpy()
    rows = moments(samples)
    training, validation = np.unique(rows[~is_validation]), np.unique(rows[is_validation])
    leaks = []
    if len(both := np.intersect1d(training, validation)):
        leaks.append(f"{_rows(both)} in training and in validation")
    is_altered = pc.not_equal(samples["alteration"], "").to_numpy() | samples["copy"].to_numpy()
    if altered := int((is_altered & is_validation).sum()):
        leaks.append(f"{counted(altered, 'sample')} of validation altered, or a copy")
    excluded = np.unique(moments(frames)[is_excluded(frames)])
    if len(used := np.intersect1d(excluded, rows)):
        leaks.append(f"{_rows(used)} tagged `exclude` and used")
    if len(again := _again(frames, training, validation)):
        leaks.append(f"{_rows(again)} in validation a second time")
    if close := _close(np.unique(moments(frames)), training, validation, gap_s):
        leaks.append(close)
    return leaks


def _again(frames: pa.Table, training: NDArray[np.void], validation: NDArray[np.void]) -> NDArray[np.void]:
    """The training rows of a moving car that equal a validation row, except for the number. Two drives in a
    simulator have the same times, and some pictures of the same length: steering and speed must be equal, too."""
    rows, picture = moments(frames), picture_keys(frames, "steering", "speed_mph")
    moves = ~(np.abs(frames["speed_mph"].to_numpy()) < STANDING_MPH)  # True if the speed is unknown
    is_held_out = np.isin(rows, validation)
    is_trained = moves & np.isin(rows, training) & ~is_held_out
    return np.unique(rows[is_trained & np.isin(picture, picture[is_held_out])])


def _rows(rows: NDArray[np.void]) -> str:
    return f"{counted(len(rows), 'row')}, the first is row {rows[0]['row']}:"


def _close(rows: NDArray[np.void], training: NDArray[np.void], validation: NDArray[np.void], gap_s: float) -> str:
    """A line about the training row that is nearest to a validation row, if it is within the gap; else ""."""
    if not len(training) or not len(validation):
        return ""
    elapsed_ns = np.concatenate([[0], np.cumsum(np.abs(np.diff(rows["log_time_ns"])))])
    trained, held_out = (elapsed_ns[np.searchsorted(rows, part)] for part in (training, validation))
    right = np.minimum(np.searchsorted(held_out, trained), len(held_out) - 1)
    left = np.maximum(right - 1, 0)
    apart_s = np.minimum(abs(held_out[right] - trained), abs(held_out[left] - trained)) / 1e9
    nearest = int(apart_s.argmin())
    if apart_s[nearest] > gap_s or (gap_s == 0 and apart_s[nearest] > 0):
        return ""
    row = training[nearest]["row"]
    return f"training row {row} is {apart_s[nearest]:.2f} s from validation, within the gap of {gap_s:g} s"
