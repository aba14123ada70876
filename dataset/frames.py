"""`index/frames/SESSION.parquet`: one row a camera picture, with where in the log its bytes lie."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from common import whole_file
from dataset.balance import bin_of
from dataset.config import IndexConfig
from dataset.split import block_numbers, validation_blocks
from recorder import Log
from recorder.quality import drive_numbers
from recorder.tags import Tag, read_tags
from recorder.topics import CAMERAS, VEHICLE, camera_topic

FORMAT: Final = 2
METADATA_KEY: Final = b"bc.index"

SCHEMA: Final = pa.schema(
    [
        pa.field("session", pa.string()),
        pa.field("row", pa.int64()),  # the frame's number in its log
        pa.field("camera", pa.string()),
        pa.field("log_time_ns", pa.int64()),
        pa.field(
            "offset", pa.int64()
        ),  # of the JPEG, in bytes from the start of the log (or of its chunk, unpacked)
        pa.field("length", pa.int64()),  # of the JPEG, in bytes
        pa.field("chunk", pa.int64()),  # where in the log the compressed chunk begins that holds it; -1: in none
        pa.field("steering", pa.float64()),
        pa.field("throttle", pa.float64()),
        pa.field("brake", pa.float64()),
        pa.field("speed_mph", pa.float64()),
        pa.field("drive", pa.int64()),
        pa.field("block", pa.int64()),
        pa.field("split", pa.string()),  # "train" or "validation"
        pa.field("bin", pa.int64()),  # of the recorded steering; -1 where that is not in -1..1
        pa.field("flags", pa.list_(pa.string())),
        pa.field("tags", pa.list_(pa.string())),  # names that somebody gave to the row with `bc-log tag`
    ]
)


def session_name(log: Path) -> str:
    """NAME of NAME.mcap, and of NAME.mcap.XXXXXX.part, whose recording was killed."""
    return re.sub(r"\.mcap(\.[0-9a-f]{6}\.part)?$", "", log.name)


def frames_metadata(log: Log, index: Path, config: IndexConfig) -> dict[str, Any]:
    """What a frames file depends on: it is up to date as long as this has not changed."""
    fingerprint = log.fingerprint
    return {
        "format": FORMAT,
        "log": Path(os.path.relpath(log.path.resolve(), index.resolve())).as_posix(),
        "fingerprint": fingerprint,
        "tags": [[tag.name, tag.first_row, tag.last_row] for tag in read_tags(log.path, fingerprint)],
        "bins": config.bins,
        "block_s": config.block_s,
        "validation": config.validation,
        "seed": config.seed,
    }


def read_metadata(path: Path) -> dict[str, Any] | None:
    """The metadata that one of our parquet files carries; None if it is missing, damaged or not ours."""
    try:
        stored = pq.read_schema(path).metadata or {}
        loaded = json.loads(stored[METADATA_KEY])
    except (OSError, ValueError, KeyError, pa.ArrowException):
        return None
    return loaded if isinstance(loaded, dict) else None


def write_table(path: Path, table: pa.Table, metadata: dict[str, Any]) -> None:
    """Write a parquet file whole, or leave the old one. Same table and metadata: same bytes."""
    stored = {METADATA_KEY: json.dumps(metadata, sort_keys=True).encode()}
    with whole_file(path, overwrite=True) as part:
        pq.write_table(table.replace_schema_metadata(stored), part, compression="zstd")


def frames_table(log: Log, session: str, config: IndexConfig) -> pa.Table:
    """One row for each camera picture that has a vehicle state, in the order of the log."""
    tags = read_tags(log.path, log.fingerprint)
    messages, states = zip(*log.vehicle_states(), strict=True) if log.counts.get(VEHICLE) else ((), ())
    row = np.array([m.sequence for m in messages], np.int64)
    time_ns = np.array([m.log_time_ns for m in messages], np.int64)
    values = {
        name: np.array([getattr(state, name) for state in states], np.float64)
        for name in ("steering", "throttle", "brake", "speed_mph")
    }
    drive = drive_numbers(time_ns)
    block = block_numbers(time_ns, drive, config.block_s)
    validation = validation_blocks(block, config.validation, config.seed, session)
    split = np.where(np.isin(block, validation), "validation", "train")
    steering = values["steering"]
    in_range = np.abs(steering) <= 1  # False for NaN too
    bins = np.where(in_range, bin_of(np.where(in_range, steering, 0.0), config.bins), -1)

    parts: list[dict[str, NDArray[Any]]] = []
    for camera in CAMERAS:
        pictures = log.pictures(camera_topic(camera))
        state, found = _rows_of(pictures.sequence, pictures.log_time_ns, row, time_ns)
        parts.append(
            {
                "row": row[state],
                "camera": np.full(len(state), camera, dtype=object),
                "log_time_ns": time_ns[state],
                "offset": pictures.offset[found],
                "length": pictures.length[found],
                "chunk": pictures.chunk[found],
                **{name: value[state] for name, value in values.items()},
                "drive": drive[state],
                "block": block[state],
                "split": split[state],
                "bin": bins[state],
                "out_of_range": ~in_range[state],
            }
        )
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.lexsort((columns["offset"], columns["chunk"]))
    columns = {name: column[order] for name, column in columns.items()}
    columns["session"] = np.full(len(order), session, dtype=object)
    columns["flags"] = [["out_of_range"] if bad else [] for bad in columns.pop("out_of_range")]
    columns["tags"] = _tags_of(columns["row"], tags)
    return pa.table({field.name: pa.array(columns[field.name], field.type) for field in SCHEMA}, schema=SCHEMA)


def _tags_of(row: NDArray[np.int64], tags: list[Tag]) -> list[list[str]]:
    names: list[list[str]] = [[] for _ in row]
    for tag in tags:
        for at in np.flatnonzero((row >= tag.first_row) & (row <= tag.last_row)).tolist():
            if tag.name not in names[at]:
                names[at].append(tag.name)
    return names


def _rows_of(
    sequence: NDArray[np.int64],
    log_time_ns: NDArray[np.int64],
    row: NDArray[np.int64],
    row_time_ns: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs pictures with vehicle states by sequence number and log time: (positions of states, of pictures)."""
    by_key = {key: i for i, key in enumerate(zip(row.tolist(), row_time_ns.tolist(), strict=True))}
    pairs = [
        (by_key[key], i)
        for i, key in enumerate(zip(sequence.tolist(), log_time_ns.tolist(), strict=True))
        if key in by_key
    ]
    states, pictures = np.array(pairs, np.int64).reshape(len(pairs), 2).T
    return states, pictures
