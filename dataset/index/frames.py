"""`index/frames/SESSION.parquet`: one row a camera picture, with where in the log its bytes lie."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from common import atomic_file
from common.car import CAMERAS, Camera
from common.files import final_path
from dataset.config import IndexConfig
from dataset.errors import DatasetError
from dataset.index.balance import bin_of
from dataset.index.drivers import DRIVERS, EXPERT, is_taken, read_commands
from dataset.index.frame_flags import Looked, Paired, frame_flags
from dataset.index.image_check_cache import read_look
from dataset.index.pairing import paired_rows
from dataset.index.samples_format import METADATA_KEY
from dataset.index.split import block_numbers, near_validation, validation_blocks
from dataset.index.topic_columns import TOPIC_COLUMNS, topic_columns
from recorder import Log, Pictures
from recorder.log.row_quality import States, drive_numbers
from recorder.log.tags import Tag
from recorder.log.topics import VEHICLE_COLUMNS, camera_topic

FORMAT: Final = 6

SCHEMA: Final = pa.schema(
    [
        pa.field("session", pa.string()),
        pa.field("row", pa.int64()),  # the frame's number in its log
        pa.field("camera", pa.string()),
        pa.field("log_time_ns", pa.int64()),
        # of the JPEG, in bytes from the start of the log (or of its chunk, unpacked)
        pa.field("offset", pa.int64()),
        pa.field("length", pa.int64()),  # of the JPEG, in bytes
        pa.field("chunk", pa.int64()),  # where in the log the compressed chunk begins that holds it; -1: in none
        # steering: where an expert drove, what he commanded
        *(pa.field(name, pa.float64()) for name in (*VEHICLE_COLUMNS, *TOPIC_COLUMNS)),
        pa.field("driver", pa.string()),  # "pilot", "expert", "human"; "" where nobody says
        pa.field("drive", pa.int64()),
        pa.field("block", pa.int64()),
        pa.field("split", pa.string()),  # "train", "validation", or "gap": left out between the two
        pa.field("bin", pa.int64()),  # of the recorded steering; -1 where that is not in -1..1
        pa.field("flags", pa.list_(pa.string())),
        pa.field("tags", pa.list_(pa.string())),  # names that somebody gave to the row with `bc-log tag`
    ]
)


class FramesError(DatasetError):
    """A frames file that is missing or damaged."""


REPEATING: Final = ("session", "camera", "driver", "split")
"""Columns of few values, which are read as dictionaries: a fraction of the memory."""


def session_name(log: Path) -> str:
    """NAME of NAME.mcap, and of NAME.mcap.XXXXXX.part, whose recording was killed."""
    return final_path(log).name.removesuffix(".mcap")


def frames_metadata(log: Log, index: Path, config: IndexConfig, tags: Sequence[Tag]) -> dict[str, Any]:
    """What a frames file depends on: it is up to date as long as this has not changed."""
    fingerprint = log.fingerprint
    return {
        "format": FORMAT,
        "log": place_of(log.path, index),
        "fingerprint": fingerprint,
        "tags": [[tag.name, tag.first_row, tag.last_row] for tag in tags],
        "looked": read_look(index, session_name(log.path), fingerprint) is not None,
        "settings": frames_settings(config, session_name(log.path)),
    }


def place_of(log: Path, index: Path) -> str:
    """Where a log is, seen from the index: both can be moved together."""
    return Path(os.path.relpath(log.resolve(), index.resolve())).as_posix()


def frames_settings(config: IndexConfig, session: str) -> dict[str, Any]:
    """The part of the settings that changes the frames of a session."""
    return {
        "bins": config.bins,
        "block_s": config.block_s,
        "gap_s": config.gap_s,
        "validation": session in config.validation if config.validation else config.validation_share,
        "seed": config.seed,
        "drives": config.drives,
        **({"columns": list(TOPIC_COLUMNS)} if TOPIC_COLUMNS else {}),
    }


def read_metadata(path: Path) -> dict[str, Any] | None:
    """The metadata that one of our parquet files carries; None if it is missing, damaged or not ours."""
    try:
        stored = pq.read_schema(path).metadata or {}
        loaded = json.loads(stored[METADATA_KEY])
    except (OSError, ValueError, KeyError, pa.ArrowException, RecursionError):
        return None
    return loaded if isinstance(loaded, dict) else None


def write_table(path: Path, table: pa.Table, metadata: dict[str, Any]) -> None:
    """Write a parquet file whole, or leave the old one. Same table and metadata: same bytes."""
    stored = {METADATA_KEY: json.dumps(metadata, sort_keys=True).encode()}
    with atomic_file(path, overwrite=True) as part:
        pq.write_table(table.replace_schema_metadata(stored), part, compression="zstd", write_page_checksum=True)


def read_frames(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """A frames file, or some columns of it. Raises FramesError if it is missing or damaged."""
    repeating = [name for name in REPEATING if columns is None or name in columns]
    try:
        return pq.read_table(
            path, columns=columns and list(columns), read_dictionary=repeating, page_checksum_verification=True
        )
    except (OSError, pa.ArrowException) as error:
        raise FramesError(
            f"{path}: damaged ({' '.join(str(error).split())}); remove it and give `bc-index`"
        ) from None


def frames_table(log: Log, index: Path, config: IndexConfig, tags: Sequence[Tag]) -> pa.Table:
    """One row for each camera picture that has a vehicle state, in the order of the log.

    `index` is the index's folder, which holds what was seen when its pictures were looked at.
    """
    states, driver = driven_states(log)
    pictures = {camera: log.pictures(camera_topic(camera)) for camera in CAMERAS}
    session = session_name(log.path)
    looked = read_look(index, session, log.fingerprint)
    return frames_of(states, pictures, session, config, tags, looked, driver, topic_columns(log, states))


def driven_states(log: Log) -> tuple[States, NDArray[np.int8]]:
    """The vehicle states of a log (N,), and who drove at each, as a position in `DRIVERS`.

    Where an expert drove, the steering is what he commanded at that picture, for it is that which he would teach:
    the wheels follow later. Raises LogError for a damaged log.
    """
    vehicle = log.vehicle()
    states = States(*(vehicle[name].to_numpy() for name in vehicle.column_names))
    commands = read_commands(log)
    state, command = paired_rows(commands, states)
    driver = np.zeros(len(states.row), np.int8)
    driver[state] = commands.driver[command]
    commanded = states.steering.copy()
    commanded[state] = commands.steering[command]
    return replace(states, steering=np.where(driver == EXPERT, commanded, states.steering)), driver


def frames_of(
    states: States,
    pictures: Mapping[Camera, Pictures],
    session: str,
    config: IndexConfig,
    tags: Sequence[Tag] = (),
    looked: Looked | None = None,
    driver: NDArray[np.int8] | None = None,
    others: Mapping[str, NDArray[np.float64]] | None = None,
) -> pa.Table:
    """The frames of a session from its vehicle states, from where its pictures lie, from who drove at each state
    (as `driven_states` gives it; without, nobody says), and from its `topic_columns` (without, NaN)."""
    if driver is None:
        driver = np.zeros(len(states.row), np.int8)
    drive = drive_numbers(states.time_ns)
    taken = is_taken(driver, config.drives)
    # A stretch of which something is taken may be short: its blocks begin with it, so that none is cut in two.
    is_edge = (np.diff(drive) != 0) | (np.diff(taken) != 0)
    stretch = np.concatenate([[0], np.cumsum(is_edge)])[: len(drive)]
    block = block_numbers(states.time_ns, stretch, config.block_s)
    split = _split_of(states, block, taken, session, config)
    in_range = np.abs(states.steering) <= 1  # False for NaN too
    bins = np.where(in_range, bin_of(np.where(in_range, states.steering, 0.0), config.bins), -1)

    parts: list[dict[str, NDArray[Any]]] = []
    paired: dict[Camera, Paired] = {}
    for number, camera in enumerate(CAMERAS):
        state, found = paired_rows(pictures[camera], states)
        paired[camera] = Paired(state, found)
        parts.append(
            {
                "state": state,
                "camera": np.full(len(state), number, np.int8),
                **{name: getattr(pictures[camera], name)[found] for name in ("offset", "length", "chunk")},
            }
        )
    places = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.lexsort((places["offset"], places["chunk"]))
    state, camera_number, offset, length, chunk = (column[order] for column in places.values())
    columns = {
        "session": pa.DictionaryArray.from_arrays(np.zeros(len(order), np.int8), [session]),
        "row": states.row[state],
        "camera": pa.DictionaryArray.from_arrays(camera_number, list(CAMERAS)),
        "log_time_ns": states.time_ns[state],
        "offset": offset,
        "length": length,
        "chunk": chunk,
        **{name: getattr(states, name)[state] for name in VEHICLE_COLUMNS},
        **{
            name: others[name][state] if others is not None else np.full(len(order), np.nan)
            for name in TOPIC_COLUMNS
        },
        "driver": pa.DictionaryArray.from_arrays(driver[state], list(DRIVERS)),
        "drive": drive[state],
        "block": block[state],
        "split": pa.DictionaryArray.from_arrays(split[state], ["train", "validation", "gap"]),
        "bin": bins[state],
        "flags": frame_flags(states, paired, looked).take(pa.array(order)),
        "tags": _tags_of(states.row[state], tags),
    }
    return pa.table({name: pa.array(column) for name, column in columns.items()}).cast(SCHEMA)


def _split_of(
    states: States, block: NDArray[np.int64], taken: NDArray[np.bool_], session: str, config: IndexConfig
) -> NDArray[np.int8]:
    """0 for training, 1 for validation, 2 for the gap between them.

    Validation is a share of what is taken, and never all of it: blocks of which nothing is used do not count.
    Takeovers are few and of any length, so that chance may hold out most of them: then it is the other way round.
    """
    if config.validation:
        return np.full(len(block), int(session in config.validation), np.int8)
    chosen = validation_blocks(block[taken], config.validation_share, config.seed, session)
    is_validation = np.isin(block, chosen)
    if not taken.all() and 2 * is_validation.sum() > taken.sum():
        is_validation = taken & ~is_validation
    near = near_validation(states.time_ns, is_validation, config.gap_s)
    return np.where(near, 2, is_validation).astype(np.int8)


def _tags_of(row: NDArray[np.int64], tags: Sequence[Tag]) -> pa.Array:
    """For each row the names of the tags that cover it."""
    if not tags:
        return pa.ListArray.from_arrays(np.zeros(len(row) + 1, np.int32), pa.array([], pa.string()))
    names: list[list[str]] = [[] for _ in row]
    for tag in tags:
        for at in np.flatnonzero((row >= tag.first_row) & (row <= tag.last_row)).tolist():
            if tag.name not in names[at]:
                names[at].append(tag.name)
    return pa.array(names, pa.list_(pa.string()))
