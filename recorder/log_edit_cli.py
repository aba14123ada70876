"""`bc-log recover`, `trim`, `merge`, `rewrite`, `split`, `export`: make new logs, or a dataset, from logs of this
machine."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import tyro

from common.command import DONE, warn, warn_skipped
from common.errors import UsageError, counted
from common.files import final_path
from common.location import Location
from common.output import print_message, print_next, print_result
from recorder.log_flag import LogFlag
from recorder.log_report import print_written

if TYPE_CHECKING:
    from recorder.lerobot.export import Exported

LocalLog = Annotated[LogFlag, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]


@dataclass(frozen=True)
class Recover:
    """Make a finished log from an unfinished or damaged one. Keeps everything with a correct CRC; names what is
    lost (exit code 3). The original stays."""

    log: LocalLog
    """The unfinished or damaged log."""
    to: Path | None = None
    """The new log; by default NAME.mcap or NAME.recovered.mcap."""
    force: bool = False
    """Replace an existing file."""

    def run(self) -> int:
        from recorder.log.reader import Log
        from recorder.upkeep.check import is_whole
        from recorder.upkeep.recover import recover, recovered_name

        path, to = self.log, recovered_name(self.log) if self.to is None else _named(self.to)
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
        return _made(to, code)


@dataclass(frozen=True)
class Trim:
    """Write a part of a log to a new one. Rows keep their numbers."""

    log: LocalLog
    """The log to trim."""
    to: Path
    """The new log."""
    start: float | None = None
    """First second, counted from the log's first row."""
    end: float | None = None
    """Last second."""
    rows: tuple[int, int] | None = None
    """First and last row, instead of times."""
    force: bool = False
    """Replace an existing file."""

    def run(self) -> int:
        from recorder.upkeep.edit import trim, trim_times

        to, code = _named(self.to), noted(self.log)
        if self.rows is not None:
            rows = rows_of_flags(self.log, self.start, self.end, self.rows)
            written = trim(self.log, to, rows, overwrite=self.force)
        else:
            written = trim_times(self.log, to, *times_of_flags(self.start, self.end), overwrite=self.force)
        return _made(to, code, print_written(written))


@dataclass(frozen=True)
class Merge:
    """Join logs, in the order given, and renumber their rows."""

    logs: Annotated[tuple[LogFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG LOG [LOG ...]")]
    """The logs to merge."""
    to: Path
    """The new log."""
    force: bool = False
    """Replace an existing file."""

    def run(self) -> int:
        from recorder.upkeep.edit import merge

        to = _named(self.to)
        refuse_fewer(self.logs, 2)
        codes = [*map(noted, self.logs)]
        for number, path in enumerate(self.logs):
            if any(map(path.samefile, self.logs[:number])):
                print_message(f"{path}: given before, so its rows are in {to} more than once")
        return _made(to, *codes, print_written(merge(self.logs, to, overwrite=self.force)))


@dataclass(frozen=True)
class Rewrite:
    """Rewrite an old log so that numbers can be read without pictures. Content, tags and fingerprint stay."""

    log: LocalLog
    """The log to rewrite."""
    to: Path
    """The new log."""
    force: bool = False
    """Replace an existing file."""

    def run(self) -> int:
        from recorder.upkeep.edit import rewrite

        to = _named(self.to)
        code = print_written(rewrite(self.log, to, overwrite=self.force))
        print_message(f"{self.log} is unchanged; check {to}, then you can replace it")
        return _made(to, code)


@dataclass(frozen=True)
class Split:
    """Write each drive to a log of its own: NAME-1.mcap, NAME-2.mcap and so on. A new drive begins after a gap of
    more than a second, or where time goes back."""

    log: LocalLog
    """The log to split."""
    to: Path | None = None
    """Folder of the new logs; by default that of the log."""
    force: bool = False
    """Replace existing files."""

    def run(self) -> int:
        from recorder.upkeep.edit import split

        folder, code = self.to or self.log.parent, noted(self.log)
        return _made(folder, code, *map(print_written, split(self.log, folder, overwrite=self.force)))


def refuse_fewer(logs: tuple[Location, ...], least: int = 1) -> None:
    if len(logs) < least:
        raise UsageError(f"give at least {counted(least, 'log')}, such as sessions/lake.mcap")


def remark_crcs(path: Location, has_crcs: bool) -> None:
    """Print that damage to a log without CRCs cannot be noticed."""
    if not has_crcs:
        from recorder.mcap.mcap_file import WITHOUT_CRCS

        print_message(f"{path}: {WITHOUT_CRCS}")


def noted(path: Location) -> int:
    """Warn of an unfinished log, or a log without CRCs, before its use; the exit code."""
    from recorder.log.reader import Log

    with Log(path) as log:
        remark_crcs(path, log.has_crcs)
        return warn(log.notice) if log.notice else DONE


def _named(to: Path) -> Path:
    if to.suffix != ".mcap":
        raise UsageError(f"{to}: the name of a log ends in .mcap; give {to}.mcap")
    return to


def _made(to: Path, *codes: int) -> int:
    """Print what to do with a new log, or a folder of new logs; the worst of the exit codes."""
    print_next(f"bc-log {'check' if to.suffix == '.mcap' else 'ls'} {shlex.quote(str(to))}")
    return max(codes)


def rows_of_flags(
    path: Location, start_s: float | None, end_s: float | None, rows: tuple[int, int] | None
) -> tuple[int, int]:
    from recorder.log.reader import Log  # NumPy
    from recorder.upkeep.edit import check_rows, rows_between

    if rows is not None:
        if start_s is not None or end_s is not None:
            raise UsageError("give either --rows, or --start and --end")
        if not 0 <= rows[0] <= rows[1]:
            raise UsageError(f"--rows {rows[0]} {rows[1]}: give the first row, then the last one")
        with Log(path) as log:
            check_rows(log, rows)
        return rows
    with Log(path) as log:
        return rows_between(log, *times_of_flags(start_s, end_s))


def times_of_flags(start_s: float | None, end_s: float | None) -> tuple[float, float]:
    begin_s, finish_s = 0.0 if start_s is None else start_s, math.inf if end_s is None else end_s
    if not 0 <= begin_s <= finish_s:
        raise UsageError(f"--start {begin_s:g} --end {finish_s:g}: give seconds from 0, the start before the end")
    return begin_s, finish_s


UPLOADS: Final = "to publish it; nothing is uploaded yet"


@dataclass(frozen=True)
class ExportLogs:
    """Write logs as a LeRobot dataset (v3.0), one episode a drive, or a log as a recording of Udacity's simulator.

    Rows tagged `exclude` stay out.
    """

    logs: Annotated[tuple[LogFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]
    """The logs to export."""
    lerobot: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """The new folder of the dataset."""
    udacity: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """The new folder of one log's driving_log.csv and IMG."""
    task: str = "Drive along the road."
    """The task in words, for networks that read it."""
    license: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """Licence of the recordings, by its Hugging Face name, such as cc-by-4.0."""
    video: bool = False
    """Encode pictures as videos: a third smaller, but lossy."""

    def run(self) -> int:
        from recorder.lerobot.export import export_lerobot  # OpenCV and Arrow

        refuse_fewer(self.logs)
        if self.lerobot is None:
            return self._to_udacity()
        if self.udacity is not None:
            raise UsageError("give one of --lerobot FOLDER and --udacity FOLDER")
        refuse_no_text(("--task", self.task), ("--license", self.license))
        done = export_lerobot(self.logs, self.lerobot, task=self.task, licence=self.license, is_video=self.video)
        return print_exported(done, has_licence=self.license is not None, is_video=self.video)

    def _to_udacity(self) -> int:
        from recorder.upkeep.export_udacity import export_udacity

        if self.udacity is None or len(self.logs) != 1:
            raise UsageError("give --lerobot FOLDER, or one log and --udacity FOLDER")
        rows, skipped = export_udacity(self.logs[0], self.udacity)
        code = warn_skipped(skipped)
        print_result(f"{self.udacity}: {counted(rows, 'row')}")
        return code


def refuse_no_text(*flags: tuple[str, str | None]) -> None:
    """Raise UsageError if a given flag's value is not a line of text."""
    for name, text in flags:
        if text is not None and (not text.strip() or not text.isprintable()):
            raise UsageError(f"{name} {text!r}: expected a line of text")


def print_exported(done: Exported, *, has_licence: bool, is_video: bool) -> int:
    code = warn_skipped(done.skipped)
    for notice in done.notices:
        print_message(notice)
    if done.excluded:
        print_message(f"{counted(done.excluded, 'row')} tagged exclude left out")
    if is_video:
        print_message("the videos are encoded anew: the original pictures are not in the dataset")
    if not has_licence:
        print_message(
            "no licence is stated: before you publish it, give --license, or write it into"
            f" {done.folder / 'README.md'}"
        )
    print_result(
        f"{done.folder}: {counted(done.episodes, 'episode')}, {counted(done.frames, 'frame')},"
        f" {counted(done.pictures, 'picture')}, {done.size_bytes / 1e6:,.1f} MB"
    )
    folder = done.folder
    print_next(f"hf upload {shlex.quote(folder.name)} {shlex.quote(str(folder))} --repo-type dataset", UPLOADS)
    return code
