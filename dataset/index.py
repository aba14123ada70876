"""Building the index: `index/frames/*.parquet` and `index/samples.parquet`, from logs.

Only what changed is read again: a frames file says which log, which content (fingerprint), which tags and which
settings it was made from. `index/state.json` remembers sizes and times of files, so that unchanged ones need not
even be opened; it may be deleted at any time.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from common import whole_file
from common.errors import shown
from common.files import final_path
from common.locks import lock
from common.progress import track
from dataset.config import IndexConfig
from dataset.errors import DatasetError
from dataset.frames import (
    FORMAT,
    SCHEMA,
    frames_metadata,
    frames_settings,
    frames_table,
    place_of,
    read_metadata,
    session_name,
    write_table,
)
from dataset.looks import LOOKS_FOLDER
from dataset.samples import Balance, SessionCounts, write_samples
from dataset.samples_format import FORMAT as SAMPLES_FORMAT
from dataset.samples_format import SAMPLES_NAME
from dataset.shared import refuse_shared_pictures
from recorder import Log, LogError
from recorder.tags import read_tags, tags_path

FRAMES_FOLDER: Final = "frames"
STATE_NAME: Final = "state.json"
LOCK_NAME: Final = ".lock"

Stat = list[int] | None
"""Size and modification time of a file; None where there is none."""


@dataclass(frozen=True)
class Indexed:
    """What an index holds."""

    path: Path
    sessions: list[str]
    read: list[str]  # those that were read again
    balance: Balance
    counts: dict[str, SessionCounts]
    notices: list[str]  # logs that were never finished, or that cannot be read at all

    @cached_property
    def frames(self) -> pa.Table:
        return pa.concat_tables(
            pq.read_table(self.path / FRAMES_FOLDER / f"{session}.parquet") for session in self.sessions
        )

    @cached_property
    def samples(self) -> pa.Table:
        return pq.read_table(self.path / SAMPLES_NAME)


def find_logs(sessions: Sequence[str], folder: Path) -> list[Path]:
    """Logs by session name (in `folder`) or by path; without any, all of `folder`.

    Raises DatasetError for one that does not exist, or for two of one name.
    """
    if sessions:
        logs = [
            Path(given) if given.endswith((".mcap", ".part")) else folder / f"{given}.mcap" for given in sessions
        ]
    else:
        logs = sorted(folder.glob("*.mcap"))
        if not logs:
            raise DatasetError(f"{folder}: no logs in it; record one with `bc-record NAME`")
    by_name: dict[str, Path] = {}
    for log in logs:
        if not log.is_file():
            raise DatasetError(f"{log}: no such log; the sessions are named by the files in {folder}")
        if not session_name(log) or shown(log.name) != log.name:
            raise DatasetError(f"{log}: a session needs a name of plain UTF-8 text; rename the log")
        other = by_name.setdefault(session_name(log), log)
        if other.resolve() != log.resolve():
            raise DatasetError(f"{log} and {other}: two sessions of one name; rename one of them")
    return list(by_name.values())


def sessions_not_indexed(index: Path, folder: Path) -> list[str]:
    """Names of the logs in `folder` that the index does not hold (by choice, or because they are newer)."""
    held = (read_metadata(index / SAMPLES_NAME) or {}).get("logs")
    if not isinstance(held, dict):
        return []
    return [name for log in sorted(folder.glob("*.mcap")) if (name := session_name(log)) not in held]


def unfinished_recordings(folder: Path, sessions: Sequence[str]) -> list[str]:
    """A line for each unfinished recording in `folder`; with `sessions`, only for those of their names."""
    return [
        f"{part}: not indexed: a recording that goes on, or was killed; then give `bc-log recover {part}`, and"
        " remove it"
        for part in sorted(folder.glob("*.mcap.*.part"))
        if not sessions or session_name(part) in sessions
    ]


def build_index(
    logs: Sequence[Path], index: Path, config: IndexConfig | None = None, *, leave_out_unreadable: bool = False
) -> Indexed:
    """Bring `index` up to date: it then holds the sessions of `logs`, and only those.

    Raises LogError if a log cannot be read (`leave_out_unreadable`: the notices name it instead), DatasetError
    if nothing in them can be used, if a picture is in two of them, or if `config` names a session that is not
    among them.
    """
    config = config or IndexConfig()
    by_name = dict(sorted((session_name(path), path) for path in logs))
    if missing := set(config.validation) - by_name.keys():
        raise DatasetError(f"--validation {' '.join(sorted(missing))}: no such session among {', '.join(by_name)}")
    index.mkdir(parents=True, exist_ok=True)
    with _alone(index):
        return _build(by_name, index, config, leave_out_unreadable)


def _build(by_name: dict[str, Path], index: Path, config: IndexConfig, leave_out_unreadable: bool) -> Indexed:
    state = _read_state(index)
    unchanged = _unchanged(by_name, index, config, state)
    if unchanged is not None and (leave_out_unreadable or len(unchanged.sessions) == len(by_name)):
        return unchanged
    frames_folder = _own_folder(index / FRAMES_FOLDER)
    _own_folder(index / LOOKS_FOLDER)
    frames_folder.mkdir(exist_ok=True)
    read: list[str] = []
    entries: dict[str, dict[str, Any]] = {}
    sources: dict[str, dict[str, str]] = {}
    for name, path in track(by_name.items(), "indexing", len(by_name)):
        # before anything is read: what changes from now on will be noticed the next time
        entry: dict[str, Any] = {"sources": _sources_of(name, path, index), "notice": "", "left_out": False}
        file = frames_folder / f"{name}.parquet"
        known = _known_frames(name, path, index, config, state)
        if known is None:
            try:
                with Log(path) as log:
                    tags = read_tags(path, log.fingerprint)
                    known = frames_metadata(log, index, config, tags)
                    if not _is_current(file, name, known):
                        write_table(file, frames_table(log, index, config, tags), known)
                        read.append(name)
                    entry["notice"] = log.notice
            except LogError as error:
                if not leave_out_unreadable or name in config.validation:
                    raise
                entry |= {"notice": f"{error}; left out", "left_out": True}
        if known is not None:
            sources[name] = {key: known[key] for key in ("log", "fingerprint")}
        entries[name] = {**entry, "frames": _stat(file)}
    notices = [entry["notice"] for entry in entries.values() if entry["notice"]]
    if not sources:
        raise LogError("; ".join(notices))
    for stale in frames_folder.iterdir():
        if stale.name.removesuffix(".parquet") not in sources and _is_ours(stale):
            stale.unlink()  # quickly made anew; a look takes longer: it stays
    files = {name: frames_folder / f"{name}.parquet" for name in sources}
    refuse_shared_pictures(files, by_name)
    balance, counts = write_samples(files, index / SAMPLES_NAME, config, sources)
    _write_state(index, entries)
    return Indexed(index, list(sources), read, balance, counts, notices)


@contextlib.contextmanager
def _alone(index: Path) -> Iterator[None]:
    """Let one at a time build this index."""
    with (index / LOCK_NAME).open("ab") as stream:
        lock(stream)
        yield


def _own_folder(folder: Path) -> Path:
    """Raises DatasetError where it is a link: what is written and deleted in it would be somebody else's."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise DatasetError(f"{folder}: not a plain folder; remove it")
    return folder


def _is_ours(file: Path) -> bool:
    """Whether a file in the frames folder was made by us; also the part of one that a killed process left."""
    if file.is_symlink() or not file.is_file():
        return False
    if (final := final_path(file)) != file and final.suffix == ".parquet":
        return True
    return (read_metadata(file) or {}).keys() >= {"format", "fingerprint", "looked", "settings"}


def _is_current(file: Path, session: str, metadata: dict[str, Any]) -> bool:
    """Whether the frames in `file` are of this log and these settings, and make sense."""
    if read_metadata(file) != metadata:
        return False
    try:
        frames = pq.read_table(file, page_checksum_verification=True)
        return (
            frames.schema.remove_metadata().equals(SCHEMA)
            and not any(column.null_count for column in frames.columns)
            and pc.all(pc.equal(frames["session"], session)).as_py() is not False
        )
    except (OSError, pa.ArrowException):
        return False


def _unchanged(
    logs: Mapping[str, Path], index: Path, config: IndexConfig, state: Mapping[str, Any]
) -> Indexed | None:
    """The index as it is, if no log, no tag, no setting and no file of it has changed."""
    samples = index / SAMPLES_NAME
    stored = read_metadata(samples)
    if stored is None or stored.get("format") != SAMPLES_FORMAT or state.get("samples") != _stat(samples):
        return None
    if json.dumps(stored.get("settings")) != json.dumps(config.as_dict(), sort_keys=True):
        return None
    if not all(_is_known(name, path, index, state) for name, path in logs.items()):
        return None
    try:
        entries = {name: state["logs"][name] for name in logs}
        held = [name for name in logs if not entries[name]["left_out"]]
        if sorted(stored["logs"]) != sorted(held) or any(
            stored["logs"][name]["log"] != place_of(logs[name], index) for name in held
        ):
            return None
        counts = {name: SessionCounts.from_dict(stored["counts"][name]) for name in held}
        notices = [entry["notice"] for entry in entries.values() if entry["notice"]]
        return Indexed(index, held, [], Balance.from_dict(stored["balance"]), counts, notices)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError):
        return None


def _known_frames(
    name: str, log: Path, index: Path, config: IndexConfig, state: Mapping[str, Any]
) -> dict[str, Any] | None:
    """The metadata of a frames file that is up to date, if that can be told without opening the log."""
    if not _is_known(name, log, index, state) or state["logs"][name]["notice"]:
        return None
    stored = read_metadata(index / FRAMES_FOLDER / f"{name}.parquet")
    expected = {"format": FORMAT, "settings": frames_settings(config, name), "log": place_of(log, index)}
    if stored is None or not isinstance(stored.get("fingerprint"), str):
        return None
    return stored if all(stored.get(key) == value for key, value in expected.items()) else None


def _is_known(name: str, log: Path, index: Path, state: Mapping[str, Any]) -> bool:
    """Whether a session's log, tags, look and frames are the files that they were."""
    try:
        entry = state["logs"][name]
        return bool(
            entry["sources"] == _sources_of(name, log, index)
            and entry["frames"] == _stat(index / FRAMES_FOLDER / f"{name}.parquet")
            and isinstance(entry["notice"], str)
            and isinstance(entry["left_out"], bool)
        )
    except (KeyError, TypeError):
        return False


def _sources_of(name: str, log: Path, index: Path) -> list[Any]:
    """What a session's frames are made of: the log, its tags, and what was seen in its pictures."""
    return [os.path.realpath(log), *map(_stat, (log, tags_path(log), index / LOOKS_FOLDER / f"{name}.json"))]


def _stat(path: Path) -> Stat:
    try:
        status = path.stat()
    except OSError:
        return None
    return [status.st_size, status.st_mtime_ns]


def _read_state(index: Path) -> dict[str, Any]:
    try:
        state = json.loads((index / STATE_NAME).read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return state if isinstance(state, dict) else {}


def _write_state(index: Path, entries: Mapping[str, Any]) -> None:
    state = {"samples": _stat(index / SAMPLES_NAME), "logs": entries}
    with whole_file(index / STATE_NAME, overwrite=True) as part:
        part.write_text(json.dumps(state, indent=1, sort_keys=True) + "\n", encoding="utf-8")
