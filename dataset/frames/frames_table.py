"""The frames of a log: its pictures, with the vehicle state and the driver at each picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from common.car import CAMERAS, Camera
from common.files import session_name
from dataset.config import IndexConfig
from dataset.frames.distinct_rows import moments, paired_rows
from dataset.frames.drivers import DRIVERS, TAKEOVERS, is_taken, read_commands
from dataset.frames.frame_flags import ImageFindings, Paired, frame_flags
from dataset.frames.frames_file import FRAMES_SCHEMA, SPLITS
from dataset.frames.image_check_cache import read_image_check
from dataset.frames.split import block_numbers, near_validation, validation_blocks
from dataset.steering_bins import bin_of
from recorder import Log, Pictures
from recorder.log.tags import Tag
from recorder.rows.causes import NOT_LEARNT
from recorder.rows.row_quality import States, drive_numbers
from recorder.topics import DEVICES, VEHICLE_COLUMNS, camera_topic


def frames_table(log: Log, index: Path, config: IndexConfig, tags: Sequence[Tag]) -> pa.Table:
    """One row for each camera picture that has a vehicle state, in the order of the log.

    `index` is the folder of the index, which may have the results of a check of the log's pictures.
    """
    states, driver = driven_states(log)
    pictures = {camera: log.pictures(camera_topic(camera)) for camera in CAMERAS}
    session = session_name(log.path)
    findings = read_image_check(index, session, log.fingerprint)
    return frames_of(states, pictures, session, config, tags, findings, driver, log.devices())


def driven_states(log: Log) -> tuple[States, NDArray[np.int8]]:
    """The vehicle states of a log (N,), and the driver at each, as a position in `DRIVERS`.

    During a takeover by an expert or a person, the steering is the command at the picture: a network is to learn
    the command, and the wheels follow later. Raises LogError if the log is damaged.
    """
    states = States.of(log.vehicle())
    commands = read_commands(log)
    state, command = paired_rows(commands, states)
    driver = np.zeros(len(states.row), np.int8)
    driver[state] = commands.driver[command]
    commanded = states.steering.copy()
    commanded[state] = commands.steering[command]
    return replace(states, steering=np.where(np.isin(driver, TAKEOVERS), commanded, states.steering)), driver


def frames_of(
    states: States,
    pictures: Mapping[Camera, Pictures],
    session: str,
    config: IndexConfig,
    tags: Sequence[Tag] = (),
    findings: ImageFindings | None = None,
    driver: NDArray[np.int8] | None = None,
    device: NDArray[np.int8] | None = None,
) -> pa.Table:
    """The frames of a session. `driver` (N,), as from `driven_states`, and `device` (N,), as from `Log.devices`,
    are those at each vehicle state; None: unknown."""
    unknown = np.zeros(len(states.row), np.int8)
    driver = unknown if driver is None else driver
    device = unknown if device is None else device
    drive = drive_numbers(states.time_ns)
    taken = is_taken(driver, config.drives)
    # a block begins at each takeover, so that no edge of a block divides a short takeover
    is_edge = (np.diff(drive) != 0) | (np.diff(taken) != 0)
    stretch = np.concatenate([[0], np.cumsum(is_edge)])[: len(drive)]
    block = block_numbers(states.time_ns, stretch, config.block_s)
    split = _split_of(states, block, taken, session, config)
    in_range = np.abs(states.steering) <= 1  # False for NaN too
    bins = np.where(in_range, bin_of(np.where(in_range, states.steering, 0.0), config.bins), -1)

    parts: list[dict[str, NDArray[Any]]] = []
    paired: dict[Camera, Paired] = {}
    for number, camera in enumerate(CAMERAS):
        state, picture = paired_rows(pictures[camera], states)
        paired[camera] = Paired(state, picture)
        parts.append(
            {
                "state": state,
                "camera": np.full(len(state), number, np.int8),
                **{name: getattr(pictures[camera], name)[picture] for name in ("offset", "length", "chunk")},
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
        "driver": pa.DictionaryArray.from_arrays(driver[state], list(DRIVERS)),
        "device": pa.DictionaryArray.from_arrays(device[state], list(DEVICES)),
        "drive": drive[state],
        "block": block[state],
        "split": pa.DictionaryArray.from_arrays(split[state], list(SPLITS)),
        "bin": bins[state],
        "flags": frame_flags(states, paired, findings).take(pa.array(order)),
        "tags": _tags_of(states.row[state], tags),
    }
    return pa.table({name: pa.array(column) for name, column in columns.items()}).cast(FRAMES_SCHEMA)


def _split_of(
    states: States, block: NDArray[np.int64], taken: NDArray[np.bool_], session: str, config: IndexConfig
) -> NDArray[np.int8]:
    """The split of each row (N,): 0 for training, 1 for validation, 2 for the gap between them.

    Validation is a share of the used frames, never all of them. Blocks without used frames do not count. Short
    drives and takeovers have few blocks, of any length. If chance holds out more than half of the frames, training
    and validation are exchanged.
    """
    if config.validation:
        return np.full(len(block), int(session in config.validation), np.int8)
    chosen = validation_blocks(block[taken], config.validation_share, config.seed, session)
    is_validation = np.isin(block, chosen)
    if config.validation_share < 0.5 and 2 * is_validation.sum() > taken.sum():
        is_validation = taken & ~is_validation
    near = near_validation(states.time_ns, is_validation, config.gap_s)
    return np.where(near, 2, is_validation).astype(np.int8)


def _tags_of(row: NDArray[np.int64], tags: Sequence[Tag]) -> pa.Array:
    if not tags:
        return pa.ListArray.from_arrays(np.zeros(len(row) + 1, np.int32), pa.array([], pa.string()))
    names: list[list[str]] = [[] for _ in row]
    for tag in tags:
        for at in np.flatnonzero((row >= tag.first_row) & (row <= tag.last_row)).tolist():
            if tag.name not in names[at]:
                names[at].append(tag.name)
    return pa.array(names, pa.list_(pa.string()))


def is_for_training(frames: pa.Table, log: Log, session: str, config: IndexConfig) -> NDArray[np.bool_]:
    """A mask (N,) of the `frames` of a log: True for the training split of an index with the settings `config`, in
    which the log is called `session`. `frames` needs the columns row and log_time_ns.

    The split is computed again from the log. It does not depend on tags, cameras and --where: a frame that one of
    these left out of training is also marked.
    """
    states, driver = driven_states(log)
    pictures = {camera: log.pictures(camera_topic(camera)) for camera in CAMERAS}
    indexed = frames_of(states, pictures, session, config, driver=driver)
    return np.isin(moments(frames), moments(indexed.filter(pc.equal(indexed["split"], "train"))))


def in_crashes(frames: pa.Table, log: Log) -> NDArray[np.bool_]:
    """A mask (N,) of the `frames` of a log: True if the row has a flag of `NOT_LEARNT`. For indexes of earlier
    versions, which lack these flags. `frames` needs the columns row and log_time_ns. Raises LogError if the log is
    damaged."""
    vehicle = log.vehicle()
    flags = States.of(vehicle).flags
    crashed = vehicle.filter(pa.array(np.logical_or.reduce([flags[flag] for flag in NOT_LEARNT])))
    return np.isin(moments(frames), moments(crashed))
