"""The jobs on a log's page: the commands of `bc-log` that check it or make new logs beside it.

Nothing is overwritten: none of them is given `--force`, and a name that is taken is refused before a job begins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from common.errors import printable
from common.files import final_name
from common.location import Location
from common.whole_number import whole_number
from recorder.upkeep.recover import recovered_name
from web.errors import WebError
from web.folders.project_folders import ProjectFolders, is_recording

_SUFFIX: Final = ".mcap"
_MAX_CHARACTERS: Final = 200  # of a new log's name


@dataclass(frozen=True)
class NewLogForm:
    """The values of a form of the page."""

    new: str = ""  # name of the new log, without its folder
    first: str = ""  # rows
    last: str = ""
    others: tuple[str, ...] = ()  # keys of the logs to merge it with


@dataclass(frozen=True)
class LogJob:
    """A command over one log: `bc-log NAME LOG`."""

    name: str
    about: str
    made: Callable[[Path], Path] | None = None  # the log that it makes by default, or the first one
    is_named: bool = True  # by the form; else by the command
    has_rows: bool = False
    has_others: bool = False

    @property
    def title(self) -> str:
        return self.name.capitalize()

    def words(self, new: Location, form: NewLogForm, logs: Mapping[str, Location]) -> list[str]:
        """The words behind the log, for the new one, the form, and all logs by key."""
        words: list[str] = []
        if self.has_rows:
            rows = [_row(form.first, "first row"), _row(form.last, "last row")]
            if rows[0] > rows[1]:
                raise WebError(f"rows {rows[0]} to {rows[1]}: the first row, then the last one", 422)
            words += ["--rows", *map(str, rows)]
        if self.has_others and not form.others:
            raise WebError("choose at least one other log to merge it with", 422)
        for key in form.others if self.has_others else ():
            if key not in logs:
                raise WebError(f"no log {key!r} next to this one; it may have been deleted, renamed or moved", 404)
            words.append(str(logs[key]))
        return [*words, f"--to={new}"] if self.made and self.is_named else words


def _beside(word: str) -> Callable[[Path], Path]:
    return lambda log: log.with_name(f"{final_name(log.name).removesuffix(_SUFFIX)}{word}{_SUFFIX}")


LOG_JOBS: Final = (
    LogJob("check", "Reads it through: CRCs, indexes, order; pictures that do not decode or are frozen; odd rows"),
    LogJob(
        "trim",
        "A part of it becomes a new log, its rows with the numbers that they have: those that are selected.",
        _beside("-trimmed"),
        has_rows=True,
    ),
    LogJob(
        "split",
        "Each drive becomes a log of its own, NAME-1, NAME-2 and so on. A drive ends with a gap of a second.",
        _beside("-1"),
        is_named=False,
    ),
    LogJob(
        "merge",
        "It and the chosen ones behind it become one new log. Its rows are numbered anew.",
        _beside("-merged"),
        has_others=True,
    ),
    LogJob(
        "recover",
        "Makes a finished log of everything complete in an unfinished or damaged one.",
        recovered_name,
    ),
)


def jobs_for(log: Location) -> list[LogJob]:
    """The jobs of a log: of one in a store, no new logs are made."""
    return [job for job in LOG_JOBS if isinstance(log, Path) or not job.made]


def log_job(name: str) -> LogJob:
    """Raises WebError if there is none of that name."""
    for job in LOG_JOBS:
        if job.name == name:
            return job
    raise WebError(f"{name!r}: no job on a log has this name", 404)


def command_line(
    job: LogJob, log: Location, form: NewLogForm, logs: Mapping[str, Location], folders: ProjectFolders
) -> tuple[list[str], Location | None]:
    """The words of the command, and the log that it makes, or the first of several; None for none. `logs` are
    those of the log's folder, by key.

    Raises WebError for what cannot be one, and where a log of the new name is there already.
    """
    if is_recording(log):
        raise WebError("this log is being recorded: new logs can be made from it when that has ended", 409)
    if job not in jobs_for(log):
        raise WebError(f"{log}: is needed on this machine; `bc-log copy {log} FOLDER` brings it here", 422)
    made = job.made(log) if job.made and isinstance(log, Path) else None
    if made is not None and form.new and job.is_named:
        made = made.with_name(_name(form.new))
    words = ["bc-log", job.name, str(log), *job.words(made or log, form, logs)]
    if made is not None and folders.is_there(made):
        raise WebError(f"{printable(str(made))}: exists already; give another name, or remove it", 409)
    try:
        "".join(words).encode()
    except UnicodeEncodeError:
        raise WebError(
            f"{printable(log.name)}: this name is not valid UTF-8; rename the log, or use bc-log", 422
        ) from None
    return words, made


def _name(given: str) -> str:
    name = given.strip().removesuffix(_SUFFIX)
    is_name = name.isprintable() and "/" not in name and "\\" not in name and not name.startswith((".", "-"))
    if not (name and is_name and len(name) <= _MAX_CHARACTERS):
        raise WebError(f"{printable(given[:60])!r}: the name of a log was expected, such as lake-2", 422)
    return name + _SUFFIX


def _row(text: str, field: str) -> int:
    row = whole_number(text)
    if row is None:
        raise WebError(f"{field}: the number of a row was expected, not {printable(text[:20])!r}", 422)
    return row
