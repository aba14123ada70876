"""Building the index: `index/frames/*.parquet` and `index/samples.parquet`, from logs.

Only what changed is read again: a frames file says which log, which content (fingerprint), which tags and which
settings it was made from. `index/state.json` remembers sizes and times of files, so that unchanged ones need not
even be opened; it may be deleted at any time.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from common import whole_file
from common.progress import track
from dataset.config import IndexConfig
from dataset.errors import DatasetError
from dataset.frames import (
    FORMAT,
    frames_metadata,
    frames_settings,
    frames_table,
    read_frames,
    read_metadata,
    session_name,
    write_table,
)
from dataset.looks import LOOKS_FOLDER
from dataset.samples import Balance, SessionCounts, write_samples
from dataset.shared import refuse_shared_pictures
from recorder import Log, LogError
from recorder.tags import tags_path

SAMPLES_NAME: Final = "samples.parquet"
FRAMES_FOLDER: Final = "frames"
STATE_NAME: Final = "state.json"

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
        other = by_name.setdefault(session_name(log), log)
        if other.resolve() != log.resolve():
            raise DatasetError(f"{log} and {other}: two sessions of one name; rename one of them")
    return list(by_name.values())


def sessions_not_indexed(index: Path, folder: Path) -> list[str]:
    """Names of the logs in `folder` that the index does not hold (by choice, or because they are newer)."""
    held = (read_metadata(index / SAMPLES_NAME) or {}).get("logs", {})
    return [name for log in sorted(folder.glob("*.mcap")) if (name := session_name(log)) not in held]


def unfinished_recordings(folder: Path, sessions: Sequence[str]) -> list[str]:
    """A line for each unfinished recording in `folder` that no session of `sessions` stands for."""
    return [
        f"{part}: not indexed: a recording that goes on, or was killed; then give `bc-log recover {part}`"
        for part in sorted(folder.glob("*.mcap.*.part"))
        if session_name(part) not in sessions
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
    by_name = {session_name(path): path for path in logs}
    if missing := set(config.validation) - by_name.keys():
        raise DatasetError(f"--validation {' '.join(sorted(missing))}: no such session among {', '.join(by_name)}")
    state = _read_state(index)
    if (unchanged := _unchanged(by_name, index, config, state)) is not None:
        return unchanged
    frames_folder = index / FRAMES_FOLDER
    frames_folder.mkdir(parents=True, exist_ok=True)
    read: list[str] = []
    notices: dict[str, str] = {}
    unreadable: dict[str, str] = {}
    sources: dict[str, dict[str, str]] = {}
    for name, path in track(by_name.items(), "indexing", len(by_name)):
        file = frames_folder / f"{name}.parquet"
        known = _known_frames(name, path, index, config, state)
        if known is None:
            try:
                with Log(path) as log:
                    known = frames_metadata(log, index, config)
                    if not _is_current(file, known):
                        write_table(file, frames_table(log, index, config), known)
                        read.append(name)
                    if log.notice:
                        notices[name] = log.notice
            except LogError as error:
                if not leave_out_unreadable or len(by_name) == 1:
                    raise
                unreadable[name] = f"{error}; left out"
                continue
        sources[name] = {key: known[key] for key in ("log", "fingerprint")}
    for stale in frames_folder.glob("*.parquet"):
        if stale.stem not in sources and read_metadata(stale) is not None:
            stale.unlink()  # ours, and quickly made anew; a look takes longer: it stays
    by_name = {name: path for name, path in by_name.items() if name in sources}
    if not by_name:
        raise LogError("; ".join(unreadable.values()))
    files = {name: frames_folder / f"{name}.parquet" for name in by_name}
    refuse_shared_pictures(files, by_name)
    balance, counts = write_samples(files, index / SAMPLES_NAME, config, sources)
    _write_state(index, by_name, notices)
    return Indexed(index, list(by_name), read, balance, counts, [*notices.values(), *unreadable.values()])


def _is_current(file: Path, metadata: dict[str, Any]) -> bool:
    """Whether the frames in `file` are of this log and these settings, and can be read."""
    if read_metadata(file) != metadata:
        return False
    try:
        read_frames(file)
    except (OSError, pa.ArrowException):
        return False
    return True


def _unchanged(
    logs: Mapping[str, Path], index: Path, config: IndexConfig, state: Mapping[str, Any]
) -> Indexed | None:
    """The index as it is, if no log, no tag, no setting and no file of it has changed."""
    samples = index / SAMPLES_NAME
    stored = read_metadata(samples)
    if stored is None or state.get("samples") != _stat(samples):
        return None
    if json.dumps(stored.get("settings")) != json.dumps(config.as_dict(), sort_keys=True):
        return None
    if set(stored.get("logs", ())) != logs.keys():
        return None
    if not all(_is_known(name, path, index, state) for name, path in logs.items()):
        return None
    with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):
        counts = {name: SessionCounts(**stored["counts"][name]) for name in logs}
        notices = [state["logs"][name]["notice"] for name in logs if state["logs"][name]["notice"]]
        return Indexed(index, list(logs), [], Balance.from_dict(stored["balance"]), counts, notices)
    return None


def _known_frames(
    name: str, log: Path, index: Path, config: IndexConfig, state: Mapping[str, Any]
) -> dict[str, Any] | None:
    """The metadata of a frames file that is up to date, if that can be told without opening the log."""
    if not _is_known(name, log, index, state) or state["logs"][name]["notice"]:
        return None
    stored = read_metadata(index / FRAMES_FOLDER / f"{name}.parquet")
    if stored is None or stored.get("format") != FORMAT or stored.get("settings") != frames_settings(config, name):
        return None
    return stored


def _is_known(name: str, log: Path, index: Path, state: Mapping[str, Any]) -> bool:
    """Whether a session's log, tags, look and frames are the files that they were."""
    try:
        entry = state["logs"][name]
        return bool(entry["files"] == _files_of(name, log, index) and isinstance(entry["notice"], str))
    except (KeyError, TypeError):
        return False


def _files_of(name: str, log: Path, index: Path) -> list[Any]:
    beside = (index / FRAMES_FOLDER / f"{name}.parquet", index / LOOKS_FOLDER / f"{name}.json")
    return [os.path.realpath(log), *map(_stat, (log, tags_path(log), *beside))]


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


def _write_state(index: Path, logs: Mapping[str, Path], notices: Mapping[str, str]) -> None:
    state = {
        "samples": _stat(index / SAMPLES_NAME),
        "logs": {
            name: {"files": _files_of(name, path, index), "notice": notices.get(name, "")}
            for name, path in logs.items()
        },
    }
    with whole_file(index / STATE_NAME, overwrite=True) as part:
        part.write_text(json.dumps(state, indent=1, sort_keys=True) + "\n", encoding="utf-8")
