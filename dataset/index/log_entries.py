"""The frames file and the entry of each log in an index. They are made again only if the log has changed."""

from __future__ import annotations

import contextlib
import filecmp
from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec

from common.car import CAMERAS
from common.location import Location, Url, relative_to
from common.tasks import Tasks, in_threads, one_by_one
from dataset.config import IndexConfig
from dataset.errors import index_write_errors, log_problem
from dataset.frames.frames_file import FRAMES_FORMAT, file_if_rewritten, frames_metadata, frames_settings
from dataset.frames.frames_table import frames_table
from dataset.frames.image_check_cache import read_image_check
from dataset.index.build_state import FRAMES_FOLDER, BuildState, BuiltLog, Stats, sources_of, stat_of
from dataset.index.sessions import name_problem
from dataset.parquet_file import read_metadata, write_table
from recorder import Log, LogError
from recorder.log.known_lag import driven_by, find_lag, known_lag, lag_path
from recorder.log.session_car import CAR_KEY, foreign_source, known_max_steering_deg, metadata_of, stored_car
from recorder.log.tags import tags_of
from recorder.pictures.picture_size import width_and_height
from recorder.rows.steering_habits import LagFinding
from recorder.topics import camera_topic
from recorder.upkeep.log_info import first_picture_sizes, set_speeds_mph


def log_entries(
    by_name: Mapping[str, Location],
    index: Path,
    config: IndexConfig,
    state: BuildState,
    damaged: Mapping[str, str],
    stage: Path,
    tasks: Tasks,
) -> Iterator[tuple[str, BuiltLog | LogError]]:
    """Yield each session with its entry, or with the error if its log cannot be read. Unchanged sessions come
    first."""
    to_read: list[str] = []
    stats = Stats()
    for name, path in by_name.items():
        try:
            if name in damaged:
                raise LogError(damaged[name])
            entry = _unchanged(name, path, index, config, state, stats)
        except LogError as error:
            yield name, error
        else:
            if entry is None:
                to_read.append(name)
            else:
                yield name, entry
    calls = [(name, by_name[name], index, config, stage) for name in to_read]
    if tasks is one_by_one and any(isinstance(by_name[name], Url) for name in to_read):
        tasks = in_threads  # reading from a store mostly waits for answers
    for number, read in tasks(_read_or_error, calls):
        yield to_read[number], read


def _unchanged(
    name: str, log: Location, index: Path, config: IndexConfig, state: BuildState, stats: Stats
) -> BuiltLog | None:
    """The entry of a session if its frames are up to date, without opening its log; else None.

    A log that was left out is always read again: its size and time do not show whether it is readable now.
    """
    entry = state.logs.get(name)
    file = index / FRAMES_FOLDER / f"{name}.parquet"
    if entry is None or not entry.fingerprint:
        return None
    if (
        entry.sources != sources_of(name, log, index, stats)
        or entry.frames is None
        or entry.frames != stat_of(file)
        or entry.lag_file != stats(lag_path(log))
    ):
        return None
    expected = {
        "format": FRAMES_FORMAT,
        "settings": frames_settings(config, name),
        "log": relative_to(log, index),
        "fingerprint": entry.fingerprint,
        **file_if_rewritten(entry.fingerprint, entry.file),
    }
    stored = read_metadata(file) or {}
    return entry if all(stored.get(key) == value for key, value in expected.items()) else None


def _read_or_error(
    name: str, path: Location, index: Path, config: IndexConfig, stage: Path
) -> BuiltLog | LogError:
    try:
        return _read(name, path, index, config, stage)
    except Exception as error:
        return log_problem(path, error)


def _read(name: str, path: Location, index: Path, config: IndexConfig, stage: Path) -> BuiltLog:
    """Read all of a log, because its fingerprint does not show damage within a chunk. The frames file is written
    to `stage`, unless the index already has an equal file.

    Raises LogError if the log is damaged, or has a name that no index can contain.
    """
    lag_file = stat_of(lag_path(path))
    sources = sources_of(name, path, index)  # before reading, so that the next build notices later changes
    if problem := name_problem(path):
        raise LogError(problem)
    with Log(path) as log:
        tags = tags_of(log)
        table = frames_table(log, index, config, tags)
        metadata = frames_metadata(log, index, config, tags)
        if (lag := _lag(log, index, name)) is not None and isinstance(path, Path):
            lag_file = stat_of(lag_path(path))  # perhaps just measured
        entry = BuiltLog(
            sources,
            log.fingerprint,
            log.file_fingerprint,
            notice=log.notice,
            has_crcs=log.has_crcs,
            driven_by=driven_by(log),
            set_speeds_mph=set_speeds_mph(log),
            sizes_px=_sizes_px(log),
            max_steering_deg=known_max_steering_deg(log),
            source=foreign_source(log),
            car=metadata_of(stored_car(log)).get(CAR_KEY, ""),
            lag=lag,
            lag_file=lag_file,
            is_mixed=isinstance(path, Url) and log.is_mixed,
        )
    file = index / FRAMES_FOLDER / f"{name}.parquet"
    new = stage / FRAMES_FOLDER / file.name
    with index_write_errors(file):
        write_table(new, table, metadata)
    if _are_equal(new, file):
        new.unlink()
        return msgspec.structs.replace(entry, frames=stat_of(file))
    return msgspec.structs.replace(entry, frames=stat_of(new))


def _lag(log: Log, index: Path, session: str) -> LagFinding | None:
    """The lag of a log's steering. On this machine, it is measured if labels need it and nobody has: in a store,
    each picture would cost a request."""
    lag, is_needed = known_lag(log)
    if lag is None and (images := read_image_check(index, session, log.fingerprint)) is not None:
        lag = images.lag
    if lag is None and is_needed and isinstance(log.path, Path):
        with contextlib.suppress(Exception):  # OpenCV may fail on untrusted pictures: then nothing is measured
            return find_lag(log)
    return lag


def _sizes_px(log: Log) -> list[tuple[int, int]]:
    """Width and height of the first picture of each camera.

    They come from the summary of the log's rows or, for logs of earlier versions, from the pictures' headers.
    """
    if (stored := first_picture_sizes(log)) is not None:
        return [stored[topic] for topic in map(camera_topic, CAMERAS) if topic in stored]
    sizes = []
    for camera in CAMERAS:
        pictures = log.pictures(camera_topic(camera))
        if len(pictures.sequence):
            data = log.read(int(pictures.offset[0]), int(pictures.length[0]), int(pictures.chunk[0]))
            sizes += [size for size in [width_and_height(data)] if size]
    return sizes


def _are_equal(new: Path, old: Path) -> bool:
    try:
        return not old.is_symlink() and filecmp.cmp(new, old, shallow=False)
    except OSError:
        return False
