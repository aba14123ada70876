"""Building the index: `index/frames/*.parquet` and `index/samples.parquet`, from logs.

Only what changed is read again: a frames file says which log, which content (fingerprint) and which
settings it was made from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from common.progress import track
from dataset.config import IndexConfig
from dataset.errors import DatasetError
from dataset.frames import frames_metadata, frames_table, read_metadata, session_name, write_table
from dataset.samples import Balance, samples_table
from dataset.shared import refuse_shared_pictures
from recorder import Log

SAMPLES_NAME = "samples.parquet"
FRAMES_FOLDER = "frames"


@dataclass(frozen=True)
class Indexed:
    """What an index holds."""

    path: Path
    sessions: list[str]
    read: list[str]  # those that were read again
    frames: pa.Table
    samples: pa.Table
    balance: Balance
    notices: list[str]  # logs that were never finished: what is complete in them is indexed


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


def build_index(logs: Sequence[Path], index: Path, config: IndexConfig | None = None) -> Indexed:
    """Bring `index` up to date: it then holds the sessions of `logs`, and only those."""
    config = config or IndexConfig()
    frames_folder = index / FRAMES_FOLDER
    frames_folder.mkdir(parents=True, exist_ok=True)
    tables: list[pa.Table] = []
    read: list[str] = []
    sources: dict[str, dict[str, str]] = {}
    notices: list[str] = []
    for path in track(logs, "indexing", len(logs)):
        name = session_name(path)
        with Log(path) as log:
            metadata = frames_metadata(log, index, config)
            if log.notice:
                notices.append(log.notice)
            sources[name] = {key: metadata[key] for key in ("log", "fingerprint")}
            file = frames_folder / f"{name}.parquet"
            table = _stored_frames(file, metadata)
            if table is None:
                table = frames_table(log, name, config)
                write_table(file, table, metadata)
                read.append(name)
        tables.append(table)
    for stale in frames_folder.glob("*.parquet"):
        if stale.stem not in sources and read_metadata(stale) is not None:
            stale.unlink()  # ours, and made anew whenever its session is indexed again
    frames = pa.concat_tables(tables)
    if not len(frames):
        raise DatasetError(f"{', '.join(map(str, logs))}: no frame with a vehicle state in it; nothing to index")
    refuse_shared_pictures(frames, {session_name(path): path for path in logs})
    samples, balance = samples_table(frames, config)
    if not len(samples):
        raise DatasetError(
            f"no frame can be used: no picture of {', '.join(config.cameras)} with steering in -1..1"
        )
    write_table(index / SAMPLES_NAME, samples, {"format": 1, "settings": config.as_dict(), "logs": sources})
    return Indexed(index, list(sources), read, frames, samples, balance, notices)


def _stored_frames(file: Path, metadata: dict[str, Any]) -> pa.Table | None:
    """The frames in `file`; None if they are of another log or other settings, missing or damaged."""
    if read_metadata(file) != metadata:
        return None
    try:
        return pq.read_table(file)
    except (OSError, pa.ArrowException):
        return None
