"""Find sessions: logs by name, logs that an index does not contain, and unfinished recordings."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from common.errors import did_you_mean, printable
from common.files import final_path, session_name
from common.location import Location, Url, absolute, location
from dataset.errors import DatasetError
from dataset.frames.frames_file import log_place
from dataset.index.build_state import read_state, sources_of
from dataset.parquet_file import read_metadata
from dataset.samples.samples_format import SAMPLES_NAME
from recorder import Log, LogError
from recorder.errors import recovery
from recorder.log_flag import logs_in
from recorder.mcap.mcap_file import McapFile
from recorder.mcap.scan import read_summary


def find_logs(sessions: Sequence[Location | str], folder: Location | str) -> list[Location]:
    """Find logs by session name (in `folder`), path or URL; without `sessions`, all of `folder`, readable or not.

    Raises DatasetError if the folder has no logs, or if a log of `sessions` does not exist, has a name that no
    index can contain, or has the name of another one.
    """
    folder = location(folder)
    if not sessions:
        if finished := finished_logs(folder):
            return finished
        if isinstance(folder, Path) and folder.is_file():
            raise DatasetError(f"{folder} is a file: give the folder of the logs, such as sessions")
        raise DatasetError(f"{folder}: contains no logs; record one with `bc-record NAME`")
    chosen: list[Location] = []
    listed: dict[Url, set[Url]] = {}
    for session in map(str, sessions):
        log = location(session) if session.endswith((".mcap", ".part")) else folder / f"{session}.mcap"
        if isinstance(log, Url):
            if log.parent not in listed:
                listed[log.parent] = set(logs_in(log.parent))
            exists = log in listed[log.parent]
        else:
            exists = log.is_file()
        if not exists:
            raise DatasetError(f"{_expected(session, log)}: no such log; {_hint(session, folder)}")
        if problem := name_problem(log):
            raise DatasetError(problem)
        chosen.append(log)
    return list(by_session_name(chosen).values())


def find_unchanged_log(session: Location | str, folder: Location | str, fingerprint: str) -> Location:
    """The log of a session, as from `find_logs`. Raises DatasetError if it has another fingerprint."""
    (path,) = find_logs([session], folder)
    with Log(path) as log:
        if log.fingerprint != fingerprint:
            raise DatasetError(
                f"{path}: changed since the run learned from it; give the unchanged logs with --sessions"
            )
    return path


def changed_logs(logs: Iterable[Location], fingerprints: Mapping[str, str]) -> list[str]:
    """The names of the sessions whose logs have other fingerprints than these. Raises LogError."""
    changed = []
    for place in logs:
        with Log(place) as log:
            if log.fingerprint != fingerprints[session_name(place)]:
                changed.append(session_name(place))
    return changed


def by_session_name(logs: Iterable[Location]) -> dict[str, Location]:
    """The logs by session name, without repeated logs. Raises DatasetError if two logs have the same name."""
    by_name: dict[str, Location] = {}
    for log in logs:
        other = by_name.setdefault(session_name(log), log)
        if absolute(other) != absolute(log):
            raise DatasetError(f"{log} and {other}: two sessions with the same name; rename one of them")
    return by_name


def _expected(session: str, log: Location) -> Location | str:
    """The place for the error about a missing log: the log's path, or the user's text if it is a path."""
    return session if isinstance(log, Path) and len(Path(session).parts) > 1 else log


def _hint(session: str, folder: Location) -> str:
    path = Path(session)
    if (path / "driving_log.csv").is_file():
        return f"this is a recording; `bc-import {shlex.quote(session)} NAME` converts it to a log"
    meant = did_you_mean(path.name, [session_name(other) for other in finished_logs(folder)])
    return meant or f"the sessions are named by the files in {folder}"


def finished_logs(folder: Location) -> list[Location]:
    return [log for log in logs_in(folder) if log.suffix == ".mcap"]


def name_problem(log: Location) -> str:
    """The reason why no index can contain a session of this name; "" if it can."""
    if session_name(log) and printable(log.name) == log.name:
        return ""
    return f"{log}: a session needs a name of plain UTF-8 text; rename the log"


def sessions_beside(logs: Sequence[Location], folder: Location) -> list[str]:
    chosen = set(map(session_name, logs))
    return [name for log in finished_logs(folder) if (name := session_name(log)) not in chosen]


def sessions_not_indexed(index: Path | str, folder: Path | str) -> list[str]:
    """The names of the logs in `folder` that are newer than the index or have changed since it was built.

    Without logs that the user left out, and without unreadable logs: `bc-index` has reported these. If all logs of
    the index are in other folders, the list is empty.
    """
    if not _is_of_logs_in(Path(index), Path(folder)):
        return []
    return logs_not_indexed(Path(index), finished_logs(Path(folder)))


def _is_of_logs_in(index: Path, folder: Path) -> bool:
    sources = (read_metadata(index / SAMPLES_NAME) or {}).get("logs", {}).values()
    folders = {absolute(log_place(source["log"], index).parent) for source in sources}
    return absolute(folder) in folders


def logs_not_indexed(index: Path, logs: Sequence[Location]) -> list[str]:
    """The same as `sessions_not_indexed`, for these logs."""
    indexed = (read_metadata(index / SAMPLES_NAME) or {}).get("logs")
    if indexed is None:
        return []
    state = read_state(index)
    missing = []
    for log in logs:
        name = session_name(log)
        entry = state.logs.get(name)
        is_reported = name in state.passed_over or (entry and entry.sources == sources_of(name, log, index))
        if name not in indexed and not is_reported:
            missing.append(name)
    return missing


def unfinished_recordings(folder: Location, sessions: Sequence[str]) -> list[str]:
    """A line for each recording without its final name in `folder`; with `sessions`, only for recordings of these
    names."""
    return [
        f"{part}: not indexed: {_why_unnamed(part)}"
        for part in (sorted(folder.glob("*.mcap.*.part")) if isinstance(folder, Path) else ())
        if not sessions or session_name(part) in sessions
    ]


def _why_unnamed(part: Path) -> str:
    with contextlib.suppress(LogError), McapFile(part) as file:
        if read_summary(file) is not None:
            final = final_path(part)
            name = "another NAME.mcap" if final.exists() else final.name
            return f"its recording is finished; rename it to {name}"
    return f"its recording is running or was killed; if killed, run {recovery(part)}, and remove it"
