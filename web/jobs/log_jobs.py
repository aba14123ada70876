"""The jobs on a log's page: the commands of `bc-log` that check a log or make new logs next to it.

Nothing is overwritten: no command gets `--force`, and a name that is taken is refused before a job starts.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from common.errors import printable
from common.files import session_name
from common.untrusted import whole_number
from recorder.upkeep.recover import recovered_name
from web.errors import WebError, or_404
from web.folders.project_folders import is_recording

_SUFFIX: Final = ".mcap"
_MAX_BYTES: Final = 200  # of a new log's name


@dataclass(frozen=True)
class NewLogForm:
    """The values of a form of the page."""

    new: str = ""  # name of the new log, without its folder
    first: str = ""  # rows
    last: str = ""
    others: tuple[str, ...] = ()  # keys of the logs to merge it with


@dataclass(frozen=True)
class LogJob:
    """A command for one log: `bc-log NAME LOG`."""

    name: str
    about: str
    made: Callable[[Path], Path] | None = None  # the log that it makes, or the first of several, by default
    is_named: bool = True  # the form names the new log; else the command does
    has_rows: bool = False
    has_others: bool = False

    @property
    def title(self) -> str:
        return self.name.capitalize()

    def words(self, new: Path, form: NewLogForm, logs: Mapping[str, Path]) -> list[str]:
        """The words after the log. `logs` are all logs of the folder, by key."""
        words: list[str] = []
        if self.has_rows:
            rows = [_row(form.first, "first row"), _row(form.last, "last row")]
            if rows[0] > rows[1]:
                raise WebError(f"rows {rows[0]} to {rows[1]}: the first row, then the last one", 422)
            words += ["--rows", *map(str, rows)]
        if self.has_others and not form.others:
            raise WebError("choose at least one other log to merge it with", 422)
        for key in form.others if self.has_others else ():
            reason = f"no log {key!r} next to this one; it may have been deleted, renamed or moved"
            words.append(str(or_404(logs.get(key), reason)))
        return [*words, f"--to={new}"] if self.made and self.is_named else words


def _suffixed(word: str) -> Callable[[Path], Path]:
    return lambda log: log.with_name(f"{session_name(log)}{word}{_SUFFIX}")


LOG_JOBS: Final = (
    LogJob("check", "Checks CRCs, indexes and order; finds broken and frozen pictures, and odd rows."),
    LogJob(
        "trim",
        "The selected rows become a new log. They keep their numbers.",
        _suffixed("-trimmed"),
        has_rows=True,
    ),
    LogJob(
        "split",
        "Each drive becomes a log: NAME-1, NAME-2 and so on. A drive ends at a gap of more than a second.",
        _suffixed("-1"),
        is_named=False,
    ),
    LogJob(
        "merge",
        "This log and the chosen ones after it become one new log. Its rows are numbered anew.",
        _suffixed("-merged"),
        has_others=True,
    ),
    LogJob(
        "recover",
        "Saves everything that is complete in an unfinished or damaged log to a new log.",
        recovered_name,
    ),
)


def log_job(name: str) -> LogJob:
    """The job of a name. Raises WebError if there is none."""
    job = next((job for job in LOG_JOBS if job.name == name), None)
    return or_404(job, f"{name!r}: no job on a log has this name")


def command_line(
    job: LogJob, log: Path, form: NewLogForm, logs: Mapping[str, Path]
) -> tuple[list[str], Path | None]:
    """The words of the command, and the log that it makes, or the first of several; None for none. `logs` are all
    logs of the folder, by key. Raises WebError for invalid values, and if a new log's name is taken."""
    if is_recording(log):
        raise WebError("this log is being recorded: wait until the recording has ended", 409)
    made = job.made(log) if job.made else None
    if made is not None and form.new and job.is_named:
        made = made.with_name(_name(form.new))
    words = ["bc-log", job.name, str(log), *job.words(made or log, form, logs)]
    if made is not None and os.path.lexists(made):
        raise WebError(f"{printable(str(made))}: exists already; give another name, or remove it", 409)
    try:
        "".join(words).encode()
    except UnicodeEncodeError:
        raise WebError(
            f"{printable(log.name)}: the name is not valid UTF-8; rename the log, or use bc-log", 422
        ) from None
    return words, made


def _name(text: str) -> str:
    name = text.strip().removesuffix(_SUFFIX)
    is_name = name.isprintable() and "/" not in name and "\\" not in name and not name.startswith((".", "-"))
    if not (name and is_name and len(name.encode()) <= _MAX_BYTES):
        raise WebError(f"{printable(text[:60])!r}: expected the name of a log, such as lake-2", 422)
    return name + _SUFFIX


def _row(text: str, field: str) -> int:
    row = whole_number(text)
    if row is None:
        raise WebError(f"{field}: expected the number of a row, not {printable(text[:20])!r}", 422)
    return row
