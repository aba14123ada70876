"""Finding sessions: logs by name, those that an index does not hold, and recordings without an end."""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from common.errors import did_you_mean, printable
from common.location import Location, Url, absolute, location
from dataset.errors import DatasetError
from dataset.frames.frames_file import log_place, session_name
from dataset.index.build_state import Stat, Stats, read_state, sources_of
from dataset.parquet_file import read_metadata
from dataset.samples.samples_format import SAMPLES_NAME
from recorder import Log
from recorder.log.logs_in_folder import logs_in


def find_logs(sessions: Sequence[Location | str], folder: Location | str) -> list[Location]:
    """Logs by session name (in `folder`) or by path or URL; without any, all of `folder`, readable or not.

    Raises DatasetError for a folder without logs, and for a log that is named here and does not exist, that has a
    name which no index can hold, or whose name another one has.
    """
    folder = location(folder)
    if not sessions:
        if logs := finished_logs(folder):
            return logs
        if isinstance(folder, Path) and folder.is_file():
            raise DatasetError(f"{folder} is a file: give the folder of the logs, such as sessions")
        raise DatasetError(f"{folder}: no logs in it; record one with `bc-record NAME`")
    chosen: list[Location] = []
    listed: dict[Url, set[Url]] = {}
    for given in map(str, sessions):
        log = location(given) if given.endswith((".mcap", ".part")) else folder / f"{given}.mcap"
        if isinstance(log, Url):
            if log.parent not in listed:
                listed[log.parent] = set(logs_in(log.parent))
            is_there = log in listed[log.parent]
        else:
            is_there = log.is_file()
        if not is_there:
            raise DatasetError(f"{_expected(given, log)}: no such log; {_hint(given, folder)}")
        if problem := name_problem(log):
            raise DatasetError(problem)
        chosen.append(log)
    return list(by_session_name(chosen).values())


def find_unchanged_log(session: Location | str, folder: Location | str, fingerprint: str) -> Location:
    """The log of a session, as `find_logs` finds it. Raises DatasetError if its fingerprint is another one."""
    (path,) = find_logs([session], folder)
    with Log(path) as log:
        if log.fingerprint != fingerprint:
            raise DatasetError(
                f"{path}: changed since the run learned from it; give the unchanged logs with --sessions"
            )
    return path


def by_session_name(logs: Iterable[Location]) -> dict[str, Location]:
    """Each log once, by the name of its session. Raises DatasetError if two of them have the same one."""
    by_name: dict[str, Location] = {}
    for log in logs:
        other = by_name.setdefault(session_name(log), log)
        if absolute(other) != absolute(log):
            raise DatasetError(f"{log} and {other}: two sessions with the same name; rename one of them")
    return by_name


def _expected(given: str, log: Location) -> Location | str:
    """Where a log was looked for; for a path without an ending, which is not a session's name, the path."""
    return given if isinstance(log, Path) and len(Path(given).parts) > 1 else log


def _hint(given: str, folder: Location) -> str:
    """A hint at the session that the user may have meant."""
    path = Path(given)
    if (path / "driving_log.csv").is_file():
        return f"this is a recording; `bc-record NAME --from {shlex.quote(given)}` makes a log of it"
    meant = did_you_mean(path.name, [session_name(other) for other in finished_logs(folder)])
    return meant or f"the sessions are named by the files in {folder}"


def finished_logs(folder: Location) -> list[Location]:
    """The logs of a folder that are finished, by name."""
    return [log for log in logs_in(folder) if log.suffix == ".mcap"]


def name_problem(log: Location) -> str:
    """Why no index can hold a session of this name; empty if it can."""
    if session_name(log) and printable(log.name) == log.name:
        return ""
    return f"{log}: a session needs a name of plain UTF-8 text; rename the log"


def sessions_beside(logs: Sequence[Location], folder: Location) -> list[str]:
    """Names of the other logs in `folder`."""
    chosen = set(map(session_name, logs))
    return [name for log in finished_logs(folder) if (name := session_name(log)) not in chosen]


def sessions_not_indexed(index: Path | str, folder: Location | str) -> list[str]:
    """Names of the logs in `folder` that the index does not hold because they are newer, or have changed since.

    Logs that were left out on purpose, and unreadable ones, were reported when the index was built. An index whose
    logs all lie elsewhere is not compared with `folder`.
    """
    if not _is_of_logs_in(Path(index), location(folder)):
        return []
    return logs_not_indexed(Path(index), finished_logs(location(folder)), Stats())


def _is_of_logs_in(index: Path, folder: Location) -> bool:
    """Whether any log of an index lies in `folder`."""
    held = (read_metadata(index / SAMPLES_NAME) or {}).get("logs")
    sources = held.values() if isinstance(held, dict) else ()
    for name in (source.get("log") for source in sources if isinstance(source, dict)):
        with contextlib.suppress(DatasetError):  # named by somebody else, and nowhere
            if isinstance(name, str) and absolute(log_place(name, index).parent) == absolute(folder):
                return True
    return False


def logs_not_indexed(index: Path, logs: Sequence[Location], stat: Callable[[Location], Stat]) -> list[str]:
    """`sessions_not_indexed` of these logs; `stat` gives the state of their files."""
    held = (read_metadata(index / SAMPLES_NAME) or {}).get("logs")
    if not isinstance(held, dict):
        return []
    state = read_state(index)
    missing = []
    for log in logs:
        name = session_name(log)
        entry = state.logs.get(name)
        is_reported = name in state.passed_over or (entry and entry.sources == sources_of(name, log, index, stat))
        if name not in held and not is_reported:
            missing.append(name)
    return missing


def unfinished_recordings(folder: Location, sessions: Sequence[str]) -> list[str]:
    """A line for each unfinished recording in `folder`; with `sessions`, only for those of their names."""
    return [
        f"{part}: not indexed: its recording is running or was killed; if killed, run `bc-log recover {part}`,"
        " and remove it"
        for part in (sorted(folder.glob("*.mcap.*.part")) if isinstance(folder, Path) else ())
        if not sessions or session_name(part) in sessions
    ]
