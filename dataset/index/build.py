"""Build the index, `index/frames/*.parquet` and `index/samples.parquet`, from logs.

Only changed files are read again: logs, tags and frames files with the size and time of the last build
(`dataset.index.build_state`) are not opened. The result depends only on the readable logs, not on earlier builds.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from common.car import MAX_STEERING_DEG
from common.errors import counted, first_of
from common.files import session_name
from common.location import Location, local_path, location, relative_to
from common.progress import track
from common.steering_unit import assumed_deg
from common.tasks import Tasks, one_by_one
from dataset.config import IndexConfig
from dataset.errors import DatasetError, SessionError, index_write_errors
from dataset.frames.frames_file import check_where, extent_of, file_if_rewritten
from dataset.index.build_state import (
    FRAMES_FOLDER,
    STATE_NAME,
    BuildState,
    BuiltLog,
    read_state,
    sources_of,
    stat_of,
    write_state,
)
from dataset.index.duplicates import shared_standing_rows
from dataset.index.log_entries import log_entries
from dataset.index.session_labels import labels_of_sessions
from dataset.index.sessions import by_session_name
from dataset.index.staging import build_lock, staged, stale_frames_files
from dataset.missing_index import other_folder, refuse_file
from dataset.parquet_file import read_columns, read_metadata
from dataset.samples.samples_format import SAMPLES_FORMAT, SAMPLES_NAME, Balance, SessionCounts, SessionLabels
from dataset.samples.samples_writer import write_samples
from recorder import LogError
from recorder.log.session_car import CAR_KEY
from recorder.mcap.mcap_file import WITHOUT_CRCS
from recorder.rows.label_plan import NOT_MEASURED

_Contents = tuple[Balance, dict[str, SessionCounts], dict[str, SessionLabels]]
"""The balance, and the counts and labels of each session."""

MAX_NAMES: Final = 8


@dataclass(frozen=True)
class Indexed:
    """The result of `build_index`: the sessions of the index, and notices about them."""

    path: Path
    sessions: list[str]
    read: list[str]  # sessions with new frames
    balance: Balance
    counts: dict[str, SessionCounts]
    notices: list[str]  # about unfinished and unreadable logs
    remarks: list[str]  # about logs without CRCs or measured lag, and logs that are slow to read from a store
    labels: dict[str, SessionLabels]  # steering habits and label plan of each session
    sizes_px: dict[str, list[tuple[int, int]]]  # width and height of the first picture of each camera, by session

    @cached_property
    def frames(self) -> pa.Table:
        return pa.concat_tables(
            pq.read_table(self.path / FRAMES_FOLDER / f"{session}.parquet") for session in self.sessions
        )

    @cached_property
    def samples(self) -> pa.Table:
        return read_columns(self.path / SAMPLES_NAME)


def build_index(
    logs: Sequence[Location | str],
    index: Path | str,
    config: IndexConfig | None = None,
    *,
    leave_out_unreadable: bool = False,
    passed_over: Sequence[str] = (),
    tasks: Tasks = one_by_one,
) -> Indexed:
    """Update `index`, so that it contains exactly the sessions of `logs`. If an error is raised, it does not
    change.

    With `leave_out_unreadable`, unreadable logs are left out and listed in the notices. `passed_over` are sessions
    that the user left out: `sessions_not_indexed` does not list them. `tasks` reads the logs on this machine or on
    a cluster (`common.ray_cluster`), with the same result.

    Raises LogError if a log cannot be read. Raises DatasetError if no frame can be used, if two logs have the same
    name or share pictures (except of a standing start), or if a file cannot be written. Also raises the errors of
    `check_settings`.
    """
    index, config = local_path(index), config or IndexConfig()
    by_name = dict(sorted(by_session_name(map(location, logs)).items()))
    check_settings(list(by_name.values()), index, config)
    build = _Build(by_name, index, config, leave_out_unreadable, sorted(passed_over), tasks)
    with build_lock(index):
        damaged = dict[str, str]()
        while True:
            try:
                return build.run(read_state(index), damaged)
            except SessionError as error:
                if not leave_out_unreadable or error.session in config.validation:
                    raise
                damaged[error.session] = str(error)


def check_settings(logs: Sequence[Location], index: Path, config: IndexConfig) -> None:
    """Check the settings of `build_index` before anything is read.

    Raises DatasetError if a session to hold out is not in `logs`, or if the index is a file, a run or a
    folder of logs. Raises UsageError if the condition is wrong.
    """
    names = sorted(map(session_name, logs))
    if missing := set(config.validation) - set(names):
        raise DatasetError(f"--validation {' '.join(sorted(missing))}: no such session among {first_of(names)}")
    refuse_file(index)
    if kind := other_folder(index):
        raise DatasetError(f"{index}: {kind}; an index needs its own folder: give --index another name")
    if config.where is not None:
        check_where(config.where)


def _refuse_different_steering(held: Mapping[str, BuiltLog]) -> None:
    (first_name, first), *others = held.items()
    for name, other in others:
        first_deg, other_deg = assumed_deg(first.max_steering_deg), assumed_deg(other.max_steering_deg)
        if other_deg != first_deg:
            raise DatasetError(
                f"sessions {first_name} and {name}: steering 1 is {first_deg:g} degrees in one and"
                f" {other_deg:g} in the other; build an index for each (`bc-index"
                f" {shlex.quote(name)} ... --index PATH`)"
            )


@dataclass(frozen=True)
class _Build:
    by_name: Mapping[str, Location]  # logs, by session
    index: Path
    config: IndexConfig
    leave_out_unreadable: bool
    passed_over: list[str]
    tasks: Tasks

    def run(self, state: BuildState, damaged: Mapping[str, str]) -> Indexed:
        """Build the index. `damaged` has the errors, by session, of logs whose damage showed only when their
        pictures were read."""
        index, config, by_name = self.index, self.config, self.by_name
        with staged(index) as stage:
            entries = self._entries(state, damaged, stage)
            read = sorted(file.stem for file in (stage / FRAMES_FOLDER).iterdir())
            held = {name: entry for name, entry in entries.items() if entry.fingerprint}
            notices = [entry.notice for entry in entries.values() if entry.notice]
            if not held:
                raise LogError("; ".join(notices))
            _refuse_different_steering(held)
            logs = {name: _about_log(by_name[name], index, entry) for name, entry in held.items()}
            contents = _up_to_date(index, held, logs, config, state)
            samples = (index if contents else stage) / SAMPLES_NAME
            if contents is None:
                frames = {
                    name: (stage if name in read else index) / FRAMES_FOLDER / f"{name}.parquet" for name in held
                }
                contents = self._write(frames, samples, held, logs)
            if samples.parent == stage or (entries, self.passed_over) != (state.logs, state.passed_over):
                built = BuildState(stat_of(samples), entries, self.passed_over)
                with index_write_errors(index / STATE_NAME):
                    write_state(samples.with_name(STATE_NAME), built)
        balance, counts, labels = contents
        sizes_px = {name: sorted(set(entry.sizes_px)) for name, entry in held.items()}
        remarks = [f"{by_name[name]}: {WITHOUT_CRCS}" for name, entry in held.items() if not entry.has_crcs]
        remarks += [_mixed(by_name[name], held[name]) for name in held if name in read and held[name].is_mixed]
        remarks += _not_measured([by_name[name] for name in held if labels[name].plan.why == NOT_MEASURED])
        return Indexed(index, list(held), read, balance, counts, notices, remarks, labels, sizes_px)

    def _entries(self, state: BuildState, damaged: Mapping[str, str], stage: Path) -> dict[str, BuiltLog]:
        """The entry of each session. If a log is unreadable and may be left out, its entry has no fingerprint."""
        entries: dict[str, BuiltLog] = {}
        read = log_entries(self.by_name, self.index, self.config, state, damaged, stage, self.tasks)
        for name, entry in track(read, "indexing", len(self.by_name)):
            if isinstance(entry, LogError):
                if not self.leave_out_unreadable or name in self.config.validation:
                    raise entry
                sources = sources_of(name, self.by_name[name], self.index)
                entry = BuiltLog(sources, notice=f"{entry}; left out")
            entries[name] = entry
        return dict(sorted(entries.items()))

    def _write(
        self,
        frames: Mapping[str, Path],
        samples: Path,
        held: Mapping[str, BuiltLog],
        logs: Mapping[str, Mapping[str, Any]],
    ) -> _Contents:
        extents = {name: extent_of(file) for name, file in frames.items()}
        standing = shared_standing_rows(frames, self.by_name, extents, self.tasks)
        labels = labels_of_sessions(frames, held, self.config, self.tasks)
        labels |= {name: replace(labels[name], shared_rows=rows) for name, rows in standing.items()}
        with index_write_errors(self.index / SAMPLES_NAME):
            return *write_samples(frames, samples, self.config, logs, labels), labels


def _mixed(log: Location, entry: BuiltLog) -> str:
    size = entry.sources[1][0] if entry.sources[1] else 0
    return (
        f"{log}: rows and pictures are mixed, because an earlier version or another program wrote the log: all"
        f" {size / 1e6:,.0f} MB were downloaded; `bc-log rewrite` separates the rows from the pictures"
    )


def _not_measured(logs: Sequence[Location]) -> list[str]:
    if not logs:
        return []
    command = shlex.join(["bc-log", "check", *map(str, logs[:MAX_NAMES])])
    more = f" (and {len(logs) - MAX_NAMES:,} more)" * (len(logs) > MAX_NAMES)
    return [
        f"the steering's lag was never measured in {counted(len(logs), 'session')} with key presses: their labels"
        f" assume no lag. `{command}`{more} measures it, and the next `bc-index` uses it"
    ]


def _about_log(log: Location, index: Path, entry: BuiltLog) -> dict[str, Any]:
    return {
        "log": relative_to(log, index),
        "fingerprint": entry.fingerprint,
        **file_if_rewritten(entry.fingerprint, entry.file),
        **({"max_steering_deg": entry.max_steering_deg} if entry.max_steering_deg != MAX_STEERING_DEG else {}),
        **({"source": entry.source} if entry.source else {}),
        **({CAR_KEY: json.loads(entry.car)} if entry.car else {}),
    }


def _up_to_date(
    index: Path, held: Mapping[str, BuiltLog], places: Mapping[str, object], config: IndexConfig, state: BuildState
) -> _Contents | None:
    """Balance, counts and labels from samples.parquet, if building it again would give the same file; else
    None."""
    before = {name: (entry.frames, entry.lag) for name, entry in state.logs.items() if entry.fingerprint}
    now = {name: (entry.frames, entry.lag) for name, entry in held.items()}
    if now != before or stale_frames_files(set(held), index):
        return None
    samples = index / SAMPLES_NAME
    stored = read_metadata(samples) or {}
    expected = {"logs": places, "settings": json.loads(json.dumps(asdict(config)))}
    if state.samples != stat_of(samples) or any(stored.get(key) != value for key, value in expected.items()):
        return None
    try:
        counts = {name: msgspec.convert(stored["counts"][name], SessionCounts) for name in held}
        labels = {name: msgspec.convert(stored["labels"][name], SessionLabels) for name in held}
        holds_out_crashes = any(count.not_measured is None for count in counts.values())  # as earlier versions did
        if holds_out_crashes or stored["format"] != SAMPLES_FORMAT:
            return None
        return Balance.from_dict(stored["balance"]), counts, labels
    except (KeyError, ValueError):  # an earlier version built it
        return None
