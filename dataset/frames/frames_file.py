"""`index/frames/SESSION.parquet`: one row for each camera picture, with the place of its bytes in the log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from common.errors import UserError
from common.files import session_name
from common.location import Location, location, relative_to
from dataset.config import IndexConfig
from dataset.errors import DatasetError
from dataset.frames.image_check_cache import read_image_check
from recorder import Log
from recorder.log.tags import Tag
from recorder.rows.condition import rows_where
from recorder.topics import VEHICLE_COLUMNS

FRAMES_FORMAT: Final = 9

FRAMES_SCHEMA: Final = pa.schema(
    [
        pa.field("session", pa.string()),
        pa.field("row", pa.int64()),  # the frame's number in its log
        pa.field("camera", pa.string()),
        pa.field("log_time_ns", pa.int64()),
        # of the JPEG, in bytes from the start of the log (or of its decompressed chunk)
        pa.field("offset", pa.int64()),
        pa.field("length", pa.int64()),  # of the JPEG, in bytes
        pa.field("chunk", pa.int64()),  # offset of the picture's compressed chunk in the log; -1: not compressed
        # steering: during a takeover, the command of the expert or human
        *(pa.field(name, pa.float64()) for name in VEHICLE_COLUMNS),
        pa.field("driver", pa.string()),  # "pilot", "expert", "human"; "" if unknown
        pa.field("device", pa.string()),  # "keyboard", "mouse", "gamepad", "touch"; "" if nobody steered by hand
        pa.field("drive", pa.int64()),
        pa.field("block", pa.int64()),
        pa.field("split", pa.string()),  # "train", "validation", or "gap": left out between the two
        pa.field("bin", pa.int64()),  # of the recorded steering; -1 if it is not in -1..1
        pa.field("flags", pa.list_(pa.string())),
        pa.field("tags", pa.list_(pa.string())),  # the row's tags, from `bc-log tag`
    ]
)

SPLITS: Final = ("train", "validation", "gap")


class FramesError(DatasetError):
    """The frames file is missing or damaged."""


REPEATING: Final = ("session", "camera", "driver", "device", "split")
"""Columns with few distinct values. They are read as dictionaries, which need less memory."""


def check_where(condition: str) -> None:
    """Raise UsageError if this is not a condition on the columns of frames."""
    rows_where(FRAMES_SCHEMA.empty_table(), condition)


def frames_metadata(log: Log, index: Path, config: IndexConfig, tags: Sequence[Tag]) -> dict[str, Any]:
    """The metadata of a frames file: everything that it depends on. If this has not changed, the file is up to
    date."""
    fingerprint = log.fingerprint
    return {
        "format": FRAMES_FORMAT,
        "log": relative_to(log.path, index),
        "fingerprint": fingerprint,
        **file_if_rewritten(fingerprint, log.file_fingerprint),
        "tags": [[tag.name, tag.first_row, tag.last_row] for tag in tags],
        "looked": read_image_check(index, session_name(log.path), fingerprint) is not None,
        "settings": frames_settings(config, session_name(log.path)),
    }


def file_if_rewritten(fingerprint: str, file: str) -> dict[str, str]:
    """The file's fingerprint, if it differs from the log's: the log was rewritten with the same content."""
    return {} if file == fingerprint else {"file": file}


def log_place(name: str, index: Path) -> Location:
    """The place of a log, from its name in an index. Raises DatasetError for an invalid name."""
    try:
        return location(name) if "://" in name else index / name
    except UserError as error:
        raise DatasetError(
            f"{index}: the index has an invalid name of a log ({error}); run `bc-index` again"
        ) from None


def frames_settings(config: IndexConfig, session: str) -> dict[str, Any]:
    return {
        "bins": config.bins,
        "block_s": config.block_s,
        "gap_s": config.gap_s,
        "validation": session in config.validation if config.validation else config.validation_share,
        "seed": config.seed,
        "drives": config.drives,
    }


def read_frames(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read all or some columns of a frames file. Raises FramesError if the file is missing or damaged."""
    repeating = [name for name in REPEATING if columns is None or name in columns]
    try:
        return pq.read_table(
            path, columns=columns and list(columns), read_dictionary=repeating, page_checksum_verification=True
        )
    except (OSError, pa.ArrowException) as error:
        why = " ".join(str(error).split())
        raise FramesError(f"{path}: damaged ({why}); remove it and run `bc-index`") from None


@dataclass(frozen=True)
class Extent:
    """The number of frames of a session, and the times of the first and the last frame."""

    frames: int
    first_ns: int
    last_ns: int


def extent_of(path: Path) -> Extent:
    times_ns = read_frames(path, ("log_time_ns",))["log_time_ns"]
    bounds = pc.min_max(times_ns).as_py()
    return Extent(len(times_ns), bounds["min"] or 0, bounds["max"] or 0)


def codes(column: pa.ChunkedArray, names: Sequence[str]) -> NDArray[np.int8]:
    """The position of each string in `names`, (N,); -1 for other strings."""
    indices = pc.index_in(column.cast(pa.string()), pa.array(names, pa.string()))
    positions: NDArray[np.int8] = pc.fill_null(indices, -1).to_numpy().astype(np.int8)
    return positions
