"""`bc-log recover`, `trim`, `merge`, `rewrite`, `split`: new logs made of logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common.command import DONE, warn
from common.errors import UsageError, counted
from common.files import final_path
from common.location import Location
from common.location_flag import LocationFlag
from common.output import print_message, print_result
from recorder.log_flag import LogFlag
from recorder.log_made_cli import MakesLogs, MakesLogsOfOne
from recorder.log_report import print_written
from recorder.log_row_flags import rows_of_flags, times_of_flags
from recorder.log_tag_cli import LogPlace


@dataclass(frozen=True)
class Recover(MakesLogsOfOne):
    """Make a finished log from an unfinished or damaged one. Keeps everything with a correct CRC; names what is
    lost (exit code 3). The original stays."""

    log: LogPlace
    """The unfinished or damaged log."""
    to: LocationFlag | None = None
    """The new log; by default NAME.mcap or NAME.recovered.mcap."""
    force: bool = False
    """Replace an existing file."""

    def target(self) -> Location:
        from recorder.upkeep.recover import recovered_name

        return recovered_name(self.log) if self.to is None else _named(self.to)

    def make_of(self, path: Path, to: Path) -> int:
        from recorder.log.reader import Log
        from recorder.upkeep.check import is_whole
        from recorder.upkeep.recover import recover

        if final_path(path) == path and is_whole(path):
            print_result(f"{path}: complete, nothing to recover{'' if self.to else '; nothing was written'}")
            if self.to is None:
                return DONE
        with Log(path) as log:
            if log.problem:
                print_message(f"{path}: {log.problem}; everything complete in it is recovered")
            remark_crcs(path, log.has_crcs)
        code = print_written(recover(path, to, overwrite=self.force))
        print_message(f"{path} is unchanged; check {to}, then you can remove it")
        return code


@dataclass(frozen=True)
class Trim(MakesLogsOfOne):
    """Write a part of a log to a new one. Rows keep their numbers."""

    log: LogPlace
    """The log to trim."""
    to: LocationFlag
    """The new log."""
    start: float | None = None
    """First second, counted from the log's first row."""
    end: float | None = None
    """Last second."""
    rows: tuple[int, int] | None = None
    """First and last row, instead of times."""
    force: bool = False
    """Replace an existing file."""

    def target(self) -> Location:
        return _named(self.to)

    def make_of(self, path: Path, to: Path) -> int:
        from recorder.upkeep.edit import trim, trim_times

        code = noted(path)
        if self.rows is not None:
            rows = rows_of_flags(path, self.start, self.end, self.rows)
            return max(code, print_written(trim(path, to, rows, overwrite=self.force)))
        start_s, end_s = times_of_flags(self.start, self.end)
        return max(code, print_written(trim_times(path, to, start_s, end_s, overwrite=self.force)))


@dataclass(frozen=True)
class Merge(MakesLogs):
    """Join logs, in the order given, and renumber their rows."""

    logs: Annotated[tuple[LogFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG LOG [LOG ...]")]
    """The logs to merge."""
    to: LocationFlag
    """The new log."""
    force: bool = False
    """Replace an existing file."""

    def originals(self) -> Sequence[Location]:
        return some_logs(self.logs, 2)

    def target(self) -> Location:
        return _named(self.to)

    def make(self, logs: Sequence[Path], to: Path) -> int:
        from recorder.upkeep.edit import merge

        code = max(map(noted, logs))
        return max(code, print_written(merge(logs, to, overwrite=self.force)))


@dataclass(frozen=True)
class Rewrite(MakesLogsOfOne):
    """Rewrite an old log so that numbers can be read without pictures. Content, tags and fingerprint stay."""

    log: LogPlace
    """The log to rewrite."""
    to: LocationFlag
    """The new log."""
    force: bool = False
    """Replace an existing file."""

    def target(self) -> Location:
        return _named(self.to)

    def make_of(self, path: Path, to: Path) -> int:
        from recorder.upkeep.edit import rewrite

        code = print_written(rewrite(path, to, overwrite=self.force))
        print_message(f"{path} is unchanged; check {to}, then you can replace it")
        return code


@dataclass(frozen=True)
class Split(MakesLogsOfOne):
    """Write each drive to a log of its own: NAME-1.mcap, NAME-2.mcap and so on. A new drive begins after a gap of
    more than a second, or where time goes back."""

    log: LogPlace
    """The log to split."""
    to: LocationFlag | None = None
    """Folder of the new logs; by default that of the log."""
    force: bool = False
    """Replace existing files."""

    def target(self) -> Location:
        return self.log.parent if self.to is None else self.to

    def make_of(self, path: Path, to: Path) -> int:
        from recorder.upkeep.edit import split

        code = noted(path)
        parts = split(path, to, overwrite=self.force)
        return max(code, *map(print_written, parts))


def some_logs(logs: tuple[Location, ...], least: int = 1) -> tuple[Location, ...]:
    """The logs that were given. Raises UsageError for fewer than `least`."""
    if len(logs) < least:
        raise UsageError(f"give at least {counted(least, 'log')}, such as sessions/lake.mcap")
    return logs


def _named(to: Location) -> Location:
    if to.suffix != ".mcap":
        raise UsageError(f"{to}: the name of a log ends in .mcap; give {to}.mcap")
    return to


def remark_crcs(path: Location, has_crcs: bool) -> None:
    """Print that damage to a log without CRCs cannot be noticed."""
    if not has_crcs:
        from recorder.mcap.mcap_file import WITHOUT_CRCS

        print_message(f"{path}: {WITHOUT_CRCS}")


def noted(path: Location) -> int:
    """Say it of an unfinished log before it is used, and of one without CRCs."""
    from recorder.log.reader import Log

    with Log(path) as log:
        remark_crcs(path, log.has_crcs)
        return warn(log.notice) if log.notice else DONE
