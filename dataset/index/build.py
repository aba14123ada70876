"""Building the index: `index/frames/*.parquet` and `index/samples.parquet`, from logs.

Only what changed is read again: logs, tags and frames files whose sizes and times are remembered
(`dataset.index.build_state`) are not even opened. Whatever came before, the files are those that the logs
which can be read give.
"""

from __future__ import annotations

import filecmp
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from common.car import CAMERAS, MAX_STEERING_DEG
from common.location import Location, Url, location
from common.progress import track
from common.tasks import Tasks, in_threads, one_by_one
from dataset.config import IndexConfig
from dataset.errors import DatasetError, index_write_errors
from dataset.frames.frames_file import (
    FRAMES_FORMAT,
    FRAMES_SCHEMA,
    FramesError,
    extent_of,
    file_if_rewritten,
    frames_metadata,
    frames_settings,
    relative_log_path,
    session_name,
)
from dataset.frames.frames_table import frames_table
from dataset.frames.image_check_cache import IMAGE_CHECKS_FOLDER
from dataset.index.build_lock import build_lock
from dataset.index.build_state import (
    FRAMES_FOLDER,
    STATE_NAME,
    BuildState,
    BuiltLog,
    Stats,
    read_state,
    sources_of,
    stat_of,
    write_state,
)
from dataset.index.duplicates import UnreadablePictureError, refuse_shared_pictures
from dataset.index.session_labels import LAGS_FOLDER, labels_of_sessions
from dataset.index.sessions import by_session_name, name_problem
from dataset.index.staging import finish_interrupted_build, staged, stale_frames_files
from dataset.missing_index import other_folder, refuse_file
from dataset.parquet_file import read_metadata, write_table
from dataset.samples.divided_writer import write_divided_samples
from dataset.samples.filter import Condition
from dataset.samples.samples_format import (
    DIVIDED_FORMAT,
    DIVIDED_FROM_FRAMES,
    SAMPLES_FOLDER,
    SAMPLES_FORMAT,
    SAMPLES_NAME,
    Balance,
    Division,
    SessionCounts,
    SessionLabels,
    sample_files,
)
from dataset.samples.samples_writer import write_samples
from recorder import Log, LogError
from recorder.errors import RecordingError
from recorder.log.log_info import driven_by, first_picture_sizes, set_speeds_mph
from recorder.log.mcap_file import WITHOUT_CRCS
from recorder.log.session_car import (
    CAR_KEY,
    UDACITY,
    Car,
    car_in,
    car_of,
    max_steering_deg_of,
    metadata_of,
    named_car,
    stored_car,
)
from recorder.log.tags import read_tags
from recorder.log.topics import QUALITY_METADATA, camera_topic
from recorder.pictures.picture_size import width_and_height


class _StaleStateError(Exception):
    """A file is not that of its size and time, or has changed at this very moment."""


@dataclass(frozen=True)
class Indexed:
    """An index that was built: its sessions, and their notices."""

    path: Path
    sessions: list[str]
    read: list[str]  # those whose frames are new
    balance: Balance
    counts: dict[str, SessionCounts]
    notices: list[str]  # logs that were never finished, or that cannot be read at all
    remarks: list[str]  # logs in which damage is not noticed
    labels: dict[str, SessionLabels]  # how each session was steered, and what was done for it
    sizes_px: dict[str, list[tuple[int, int]]]  # of each session, width and height of its cameras' first pictures

    @cached_property
    def frames(self) -> pa.Table:
        return pa.concat_tables(
            pq.read_table(self.path / FRAMES_FOLDER / f"{session}.parquet") for session in self.sessions
        )

    @cached_property
    def samples(self) -> pa.Table:
        return pa.concat_tables(map(pq.read_table, sample_files(self.path)))


def build_index(
    logs: Sequence[Location | str],
    index: Path | str,
    config: IndexConfig | None = None,
    *,
    leave_out_unreadable: bool = False,
    passed_over: Sequence[str] = (),
    tasks: Tasks = one_by_one,
    divide_from_frames: int = DIVIDED_FROM_FRAMES,
) -> Indexed:
    """Bring `index` up to date: it then holds the sessions of `logs`, and only those.

    It changes whole or, where anything is raised, not at all. Raises LogError if a log cannot be read
    (`leave_out_unreadable`: it is left out, and the notices name it), DatasetError if nothing in them can be used,
    if two of them have the same name or a picture in common, if `config` names a session that is not among them,
    or if a file cannot be written; and what `check_settings` does. `passed_over` are the sessions that somebody
    chose not to have in the index: `sessions_not_indexed` does not list them. `tasks` reads the logs: here, or
    on a cluster (`common.ray_cluster`), which comes to the same bytes. With `divide_from_frames` or more, the
    samples are a file a session (`dataset.samples.divided_writer`).
    """
    index, config = Path(index), config or IndexConfig()
    by_name = dict(sorted(by_session_name(map(location, logs)).items()))
    check_settings(list(by_name.values()), index, config)
    with build_lock(index):
        finish_interrupted_build(index)
        state, damaged = read_state(index), dict[str, str]()
        while True:
            try:
                return _build(
                    by_name,
                    index,
                    config,
                    state,
                    leave_out_unreadable,
                    passed_over,
                    damaged,
                    tasks,
                    divide_from_frames,
                )
            except _StaleStateError:
                state = BuildState.nothing()
            except UnreadablePictureError as error:  # nobody else looks at pictures here
                if not leave_out_unreadable or error.session in config.validation:
                    raise
                damaged[error.session] = str(error)


def check_settings(logs: Sequence[Location], index: Path, config: IndexConfig) -> None:
    """Raise what `build_index` could raise without having read anything.

    That is DatasetError for a session to hold out that is not among `logs`, for a condition that is none, and for
    an index that is no plain folder, or whose folder is a run or holds logs; UserError if DuckDB is missing.
    """
    names = sorted(map(session_name, logs))
    if missing := set(config.validation) - set(names):
        raise DatasetError(f"--validation {' '.join(sorted(missing))}: no such session among {', '.join(names)}")
    refuse_file(index)
    if what := other_folder(index):
        raise DatasetError(f"{index}: {what}; an index needs a folder of its own: give --index another name")
    for folder in (index / name for name in (FRAMES_FOLDER, IMAGE_CHECKS_FOLDER, LAGS_FOLDER, SAMPLES_FOLDER)):
        # what is written and deleted in a link would be somebody else's
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise DatasetError(f"{folder}: not a plain folder; remove it")
    if config.where is not None:
        Condition(config.where).check(FRAMES_SCHEMA.empty_table())


def _car_to_warp(path: Location, entry: BuiltLog) -> Car:
    """The car of a session; its log is opened again only if the car is unknown. Raises DatasetError for one whose
    pictures cannot be warped: the places of its cameras are unknown, or how much their crops show to either
    side."""
    has_several_sizes = entry.has_several_sizes
    car = car_in({CAR_KEY: entry.car}, path) if entry.car else None
    if car is None and entry.implied_car:
        car = named_car(entry.implied_car)
    if car is None or has_several_sizes is None:
        with Log(path) as log:
            has_several_sizes = _has_several_sizes(log)
            try:
                car = car or car_of(log)
            except RecordingError as error:
                raise DatasetError(f"--viewpoints: {error}") from None
    if has_several_sizes:
        raise DatasetError(
            f"--viewpoints: {path}: a camera's pictures are of several sizes; views are warped only from pictures"
            " of one (`bc-log trim`, `bc-log split`)"
        )
    return car


def _implied_car(log: Log) -> str:
    """The name of the car of a log that stores none; empty if it is unknown."""
    try:
        return "udacity" if car_of(log) == UDACITY else "built-in"
    except RecordingError:
        return ""


def _has_several_sizes(log: Log) -> bool:
    return "picture_sizes" in log.read_metadata(QUALITY_METADATA)


def _refuse_different_steering(held: Mapping[str, BuiltLog]) -> None:
    """Raise DatasetError where the same number would be another angle of the wheels."""
    (first, one), *others = held.items()
    for name, other in others:
        if other.max_steering_deg != one.max_steering_deg:
            raise DatasetError(
                f"sessions {first} and {name}: steering 1 is {one.max_steering_deg:g} degrees in one and"
                f" {other.max_steering_deg:g} in the other; give each kind an index of its own (`bc-index"
                f" {name} ... --index PATH`)"
            )


def _build(
    by_name: dict[str, Location],
    index: Path,
    config: IndexConfig,
    state: BuildState,
    leave_out_unreadable: bool,
    passed_over: Sequence[str],
    damaged: Mapping[str, str],
    tasks: Tasks,
    divide_from_frames: int,
) -> Indexed:
    """`damaged`: what was found of logs that look sound while their pictures are not read."""
    entries: dict[str, BuiltLog] = {}
    with staged(index) as stage:
        found = _entries(by_name, index, config, state, damaged, stage, tasks)
        for name, entry in track(found, "indexing", len(by_name)):
            if isinstance(entry, LogError):
                if not leave_out_unreadable or name in config.validation:
                    raise entry
                entry = BuiltLog(sources_of(name, by_name[name], index), notice=f"{entry}; left out")
            entries[name] = entry
        entries = dict(sorted(entries.items()))
        read = sorted(file.stem for file in (stage / FRAMES_FOLDER).iterdir())
        held = {name: entry for name, entry in entries.items() if entry.fingerprint}
        notices = [entry.notice for entry in entries.values() if entry.notice]
        if not held:
            raise LogError("; ".join(notices))
        _refuse_different_steering(held)
        cars: dict[str, Car] = {}  # of the sessions that views are taken of
        if config.viewpoints:
            cars = {name: _car_to_warp(by_name[name], entry) for name, entry in held.items()}
        remarks = [f"{by_name[name]}: {WITHOUT_CRCS}" for name, entry in held.items() if not entry.has_crcs]
        places = {
            name: {
                "log": relative_log_path(by_name[name], index),
                "fingerprint": entry.fingerprint,
                **file_if_rewritten(entry.fingerprint, entry.file),
                **_about_car(entry, cars.get(name)),
            }
            for name, entry in held.items()
        }
        remarks += [
            _mixed(by_name[name], entry) for name, entry in held.items() if name in read and entry.is_mixed
        ]
        sizes_px = {name: sorted(set(entry.sizes_px)) for name, entry in held.items()}
        made = _up_to_date(index, held, places, config, state, divide_from_frames)
        samples = (index if made else stage) / SAMPLES_NAME
        if made is None:
            frames = {
                name: (stage if name in read else index) / FRAMES_FOLDER / f"{name}.parquet" for name in held
            }
            try:
                extents = {name: extent_of(file) for name, file in frames.items()}
                refuse_shared_pictures(frames, by_name, extents, tasks)
                labels = labels_of_sessions(frames, by_name, held, index, config, tasks)
                with index_write_errors(index / SAMPLES_NAME):
                    if sum(extent.frames for extent in extents.values()) < divide_from_frames:
                        written = write_samples(frames, samples, config, places, labels, cars)
                    else:
                        written = write_divided_samples(frames, samples, config, places, labels, cars, tasks)
                made = (*written, labels)
            except (LogError, FramesError):
                if state.logs:
                    raise _StaleStateError from None
                raise
        if samples.parent == stage or (entries, sorted(passed_over)) != (state.logs, state.passed_over):
            with index_write_errors(index / STATE_NAME):
                write_state(
                    samples.with_name(STATE_NAME), BuildState(stat_of(samples), entries, sorted(passed_over))
                )
    balance, counts, labels = made
    return Indexed(index, list(held), read, balance, counts, notices, remarks, labels, sizes_px)


def _entries(
    by_name: Mapping[str, Location],
    index: Path,
    config: IndexConfig,
    state: BuildState,
    damaged: Mapping[str, str],
    stage: Path,
    tasks: Tasks,
) -> Iterator[tuple[str, BuiltLog | LogError]]:
    """The entry of each session, or why its log cannot be read, as they come."""
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
        tasks = in_threads  # they wait for answers
    for number, read in tasks(_read_or_error, calls):
        yield to_read[number], read


def _unchanged(
    name: str, log: Location, index: Path, config: IndexConfig, state: BuildState, stats: Stats
) -> BuiltLog | None:
    """The entry of a session whose frames are up to date, if its log need not be opened to know that.

    One that was left out is always tried again: its size and time do not show whether it may be read now.
    """
    entry = state.logs.get(name)
    file = index / FRAMES_FOLDER / f"{name}.parquet"
    if entry is None or not entry.fingerprint:
        return None
    if (
        entry.sources != sources_of(name, log, index, stats)
        or entry.frames is None
        or entry.frames != stat_of(file)
    ):
        return None
    if not entry.file:  # as an earlier version left it, to which a rewritten log was another one, without its tags
        with Log(log) as opened:
            if opened.fingerprint != entry.fingerprint:
                return None
        entry = msgspec.structs.replace(entry, file=entry.fingerprint)
    expected = {
        "format": FRAMES_FORMAT,
        "settings": frames_settings(config, name),
        "log": relative_log_path(log, index),
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
    except LogError as error:
        return error


def _read(name: str, path: Location, index: Path, config: IndexConfig, stage: Path) -> BuiltLog:
    """Read a log, all of it: its fingerprint does not show damage within a chunk. Its frames file is put into
    `stage`, unless the index has the very same.

    Raises LogError for a log that is damaged, or whose name no index can hold.
    """
    sources = sources_of(name, path, index)  # before anything is read: what changes from now on will be noticed
    if problem := name_problem(path):
        raise LogError(problem)
    with Log(path) as log:
        tags = read_tags(path, log.fingerprint)
        table = frames_table(log, index, config, tags)
        metadata = frames_metadata(log, index, config, tags)
        car = stored_car(log)
        entry = BuiltLog(
            sources,
            log.fingerprint,
            log.file_fingerprint,
            notice=log.notice,
            has_crcs=log.has_crcs,
            driven_by=driven_by(log),
            set_speeds_mph=set_speeds_mph(log),
            sizes_px=_sizes_px(log),
            max_steering_deg=max_steering_deg_of(log),
            car=metadata_of(car).get(CAR_KEY, ""),
            implied_car=_implied_car(log) if car is None else "",
            has_several_sizes=_has_several_sizes(log),
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


def _mixed(log: Location, entry: BuiltLog) -> str:
    size = entry.sources[1][0] if entry.sources[1] else 0
    return (
        f"{log}: its rows lie among its pictures, as an earlier version or another program wrote them: all of"
        f" its {size / 1e6:,.0f} MB came here; `bc-log rewrite` makes a log of it whose rows are read alone"
    )


def _about_car(entry: BuiltLog, views_car: Car | None) -> dict[str, Any]:
    """The entry of a session's car in the samples' metadata: that of its log, or the one of its views."""
    steering = {"max_steering_deg": entry.max_steering_deg}
    car = metadata_of(views_car).get(CAR_KEY, entry.car)
    return {
        **(steering if entry.max_steering_deg != MAX_STEERING_DEG else {}),
        **({CAR_KEY: json.loads(car)} if car else {}),
    }


def _sizes_px(log: Log) -> list[tuple[int, int]]:
    """Width and height of the first picture of each camera, as its header has it.

    A log's summary of its rows has them; those of earlier versions do not.
    """
    if (known := first_picture_sizes(log)) is not None:
        return [known[topic] for topic in map(camera_topic, CAMERAS) if topic in known]
    sizes = []
    for camera in CAMERAS:
        found = log.pictures(camera_topic(camera))
        if len(found.sequence):
            data = log.read(int(found.offset[0]), int(found.length[0]), int(found.chunk[0]))
            sizes += [size for size in [width_and_height(data)] if size]
    return sizes


def _are_equal(new: Path, old: Path) -> bool:
    try:
        return not old.is_symlink() and filecmp.cmp(new, old, shallow=False)
    except OSError:
        return False


def _up_to_date(
    index: Path,
    held: Mapping[str, BuiltLog],
    places: Mapping[str, object],
    config: IndexConfig,
    state: BuildState,
    divide_from_frames: int,
) -> tuple[Balance, dict[str, SessionCounts], dict[str, SessionLabels]] | None:
    """Balance, counts and labels from samples.parquet, if building it anew would give the same file."""
    before = {name: entry.frames for name, entry in state.logs.items() if entry.fingerprint}
    if {name: entry.frames for name, entry in held.items()} != before or stale_frames_files(set(held), index):
        return None
    samples = index / SAMPLES_NAME
    stored = read_metadata(samples) or {}
    expected = {"logs": places, "settings": json.loads(json.dumps(asdict(config)))}
    if state.samples != stat_of(samples) or any(stored.get(key) != value for key, value in expected.items()):
        return None
    try:
        counts = {name: msgspec.convert(stored["counts"][name], SessionCounts) for name in held}
        labels = {name: msgspec.convert(stored["labels"][name], SessionLabels) for name in held}
        is_divided = sum(count.frames for count in counts.values()) >= divide_from_frames
        parts = Division.of(stored)
        if stored["format"] != (DIVIDED_FORMAT if is_divided else SAMPLES_FORMAT) or (parts is None) == is_divided:
            return None
        if parts is not None and not all(Path(str(place)).is_file() for place in parts.places(index)):
            return None
        return Balance.from_dict(stored["balance"]), counts, labels
    except (OSError, KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError):
        return None
