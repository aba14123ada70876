"""`bc-log`: looks after logs."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import tyro

from common import UserError
from common.command import DONE, DONE_BUT_SKIPPED, FAILED, print_error, run_command, warn
from common.errors import UsageError, counted, printable
from common.files import final_path
from common.location import Location
from common.location_flag import LocationFlag
from common.output import print_message, print_result
from recorder.log.check import check, is_whole
from recorder.log.edit import merge, rewrite, split, trim, trim_times
from recorder.log.log_info import describe
from recorder.log.mcap_file import WITHOUT_CRCS
from recorder.log.reader import Log
from recorder.log.recover import recover, recovered_name
from recorder.log_copy_cli import CopyLogs
from recorder.log_export_cli import ExportLogs
from recorder.log_list_cli import ListLogs
from recorder.log_made_cli import make_logs
from recorder.log_report import print_checked, print_info, print_written
from recorder.log_row_flags import rows_of_flags, times_of_flags
from recorder.log_tag_cli import LogPlace, NameRows, warn_stale


@dataclass(frozen=True)
class ShowInfo:
    """What a log holds, where it comes from, and how it was steered; reads its end only, so it is quick however
    long the log is."""

    logs: Annotated[tuple[LocationFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]
    """The logs to describe."""
    look: bool = False
    """Measure the lag of the steering, too, in up to 1,500 pictures."""
    json: bool = False
    """One JSON object a log, and no table."""

    def run(self) -> int:
        return _each(self.logs, self._one)

    def _one(self, path: Location) -> int:
        info = describe(path, look=self.look)
        if self.json:
            print_result(json.dumps(dataclasses.asdict(info), allow_nan=False))
        else:
            print_info(info)
        code = warn_stale(path, info.stale_tags)
        return warn(info.notice) if info.notice else code


@dataclass(frozen=True)
class Check:
    """Read logs through and say what is wrong: CRCs, indexes, order; pictures that do not decode or are frozen,
    rows without one, gaps, stuck steering, steering that contradicts the pictures, values out of range. Exit code
    3 if something was found."""

    logs: Annotated[tuple[LocationFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]
    """The logs to look through."""
    look: bool = True
    """Decode every picture, and compare them with the steering; --no-look leaves that out and is several times
    faster."""
    json: bool = False
    """One JSON object a log, with every finding."""

    def run(self) -> int:
        return _each(self.logs, self._one)

    def _one(self, path: Location) -> int:
        checked = check(path, look=self.look)
        if self.json:
            found = [finding._asdict() for finding in checked.findings]
            result = {"path": str(path), "messages": checked.messages, "pictures_decoded": checked.pictures}
            more = {"has_crcs": checked.has_crcs, "meant_gaps": checked.meant_gaps, "findings": found}
            print_result(json.dumps({**result, **more}))
        else:
            print_checked(checked)
            _remark_crcs(path, checked.has_crcs)
        return DONE_BUT_SKIPPED if checked.findings else DONE


@dataclass(frozen=True)
class Cameras:
    """How far the side cameras are from the centre one, measured in their pictures, and the `bc-index
    --side-correction` that goes with it: 0.2 is that of Udacity's."""

    logs: Annotated[tuple[LocationFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]
    """Logs with pictures of all three cameras."""

    def run(self) -> int:
        return _each(self.logs, self._one)

    def _one(self, path: Location) -> int:
        from recorder.log.side_cameras import UDACITY_SPACING, side_cameras  # OpenCV

        code = _noted(path)
        with Log(path) as log:
            found = side_cameras(log)
        print_result(
            printable(
                f"{path}: each side camera is {found.spacing:.2f} of its height above the road from the centre one"
                f" (Udacity's: {UDACITY_SPACING:g}), in {counted(found.moments, 'moment')}:"
                f" `bc-index --side-correction {found.side_correction:g}`"
            )
        )
        return code


@dataclass(frozen=True)
class Recover:
    """Make a finished log out of one that is not (its recording was killed), or out of a damaged one. The original
    stays. Everything is kept whose CRC holds; what is lost is named, with exit code 3. A log that is
    whole is not copied, unless --to asks for it."""

    log: LogPlace
    """The unfinished or damaged log."""
    to: LocationFlag | None = None
    """The new log; by default NAME.mcap for NAME.mcap.XXXXXX.part, else NAME.recovered.mcap."""
    force: bool = False
    """Replace a file of the new log's name."""

    def run(self) -> int:
        return make_logs(self)

    def originals(self) -> Sequence[Location]:
        return (self.log,)

    def target(self) -> Location:
        return recovered_name(self.log) if self.to is None else _named(self.to)

    def make(self, logs: Sequence[Path], to: Path) -> int:
        (path,) = logs
        if final_path(path) == path and is_whole(path):
            print_result(f"{path}: whole, nothing to recover{'' if self.to else '; nothing was written'}")
            if self.to is None:
                return DONE
        with Log(path) as log:
            if log.problem:
                print_message(f"{path}: {log.problem}; all that is whole in it is recovered")
            _remark_crcs(path, log.has_crcs)
        code = print_written(recover(path, to, overwrite=self.force))
        print_message(f"{path} is as it was; once {to} is checked it can be removed")
        return code


@dataclass(frozen=True)
class Trim:
    """Write a part of a log to a new one. Rows keep their numbers."""

    log: LogPlace
    """The log to take a part of."""
    to: LocationFlag
    """The new log."""
    start: float | None = None
    """From this second on, counted from the log's first row."""
    end: float | None = None
    """Up to this second."""
    rows: tuple[int, int] | None = None
    """The first and the last row to take, instead of times."""
    force: bool = False
    """Replace a file of the new log's name."""

    def run(self) -> int:
        return make_logs(self)

    def originals(self) -> Sequence[Location]:
        return (self.log,)

    def target(self) -> Location:
        return _named(self.to)

    def make(self, logs: Sequence[Path], to: Path) -> int:
        (path,) = logs
        code = _noted(path)
        if self.rows is not None:
            rows = rows_of_flags(path, self.start, self.end, self.rows)
            return max(code, print_written(trim(path, to, rows, overwrite=self.force)))
        start_s, end_s = times_of_flags(self.start, self.end)
        return max(code, print_written(trim_times(path, to, start_s, end_s, overwrite=self.force)))


@dataclass(frozen=True)
class Merge:
    """Write several logs into one new log, in the order given; its rows are numbered anew."""

    logs: Annotated[tuple[LocationFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG LOG [LOG ...]")]
    """The logs to merge."""
    to: LocationFlag
    """The new log."""
    force: bool = False
    """Replace a file of the new log's name."""

    def run(self) -> int:
        return make_logs(self)

    def originals(self) -> Sequence[Location]:
        return _some(self.logs, 2)

    def target(self) -> Location:
        return _named(self.to)

    def make(self, logs: Sequence[Path], to: Path) -> int:
        code = max(map(_noted, logs))
        return max(code, print_written(merge(logs, to, overwrite=self.force)))


@dataclass(frozen=True)
class Rewrite:
    """Write a log of an earlier version as this one writes logs: pictures in chunks of their own, so that whoever
    wants numbers reads none of them. Pictures, rows, times and tags stay as they are, and runs know it again."""

    log: LogPlace
    """The log to write anew."""
    to: LocationFlag
    """The new log."""
    force: bool = False
    """Replace a file of the new log's name."""

    def run(self) -> int:
        return make_logs(self)

    def originals(self) -> Sequence[Location]:
        return (self.log,)

    def target(self) -> Location:
        return _named(self.to)

    def make(self, logs: Sequence[Path], to: Path) -> int:
        (path,) = logs
        code = print_written(rewrite(path, to, overwrite=self.force))
        print_message(f"{path} is as it was; once {to} is checked it can take its place")
        return code


@dataclass(frozen=True)
class Split:
    """Write each drive of a log to a new log of its own: NAME-1.mcap, NAME-2.mcap and so on. A new drive begins
    after a gap of more than a second, or where time goes back."""

    log: LogPlace
    """The log to split."""
    to: LocationFlag | None = None
    """Folder for the new logs; by default that of the log."""
    force: bool = False
    """Replace files of the new logs' names."""

    def run(self) -> int:
        return make_logs(self)

    def originals(self) -> Sequence[Location]:
        return (self.log,)

    def target(self) -> Location:
        return self.log.parent if self.to is None else self.to

    def make(self, logs: Sequence[Path], to: Path) -> int:
        (path,) = logs
        code = _noted(path)
        parts = split(path, to, overwrite=self.force)
        return max(code, *map(print_written, parts))


AnyLocation = TypeVar("AnyLocation", bound=Location)

Command = (
    Annotated[ListLogs, tyro.conf.subcommand("ls")]
    | Annotated[ShowInfo, tyro.conf.subcommand("info")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Cameras, tyro.conf.subcommand("cameras")]
    | Annotated[Recover, tyro.conf.subcommand("recover")]
    | Annotated[Trim, tyro.conf.subcommand("trim")]
    | Annotated[Merge, tyro.conf.subcommand("merge")]
    | Annotated[Rewrite, tyro.conf.subcommand("rewrite")]
    | Annotated[Split, tyro.conf.subcommand("split")]
    | Annotated[NameRows, tyro.conf.subcommand("tag")]
    | Annotated[CopyLogs, tyro.conf.subcommand("copy")]
    | Annotated[ExportLogs, tyro.conf.subcommand("export")]
)


def _some(logs: tuple[AnyLocation, ...], least: int = 1) -> tuple[AnyLocation, ...]:
    if len(logs) < least:
        raise UsageError(f"give at least {counted(least, 'log')}, such as sessions/lake.mcap")
    return logs


def _named(to: Location) -> Location:
    if to.suffix != ".mcap":
        raise UsageError(f"{to}: a log ends in .mcap, or no other command finds it; give {to}.mcap")
    return to


def _each(logs: tuple[Location, ...], action: Callable[[Location], int]) -> int:
    """Do it for every log, also behind one that cannot be read; the worst of the exit codes."""
    codes = []
    for path in _some(logs):
        try:
            codes.append(action(path))
        except UserError as error:
            codes.append(print_error("bc-log", error))
    return FAILED if FAILED in codes else max(codes)


def _remark_crcs(path: Location, has_crcs: bool) -> None:
    if not has_crcs:
        print_message(f"{path}: {WITHOUT_CRCS}")


def _noted(path: Location) -> int:
    """Say it of an unfinished log before it is used, and of one without CRCs."""
    with Log(path) as log:
        _remark_crcs(path, log.has_crcs)
        return warn(log.notice) if log.notice else DONE


ABOUT = """Look after logs: what is in one, is it sound, make new ones of it, name stretches of it.

Nothing edits a log in place.

    bc-log ls
    bc-log info sessions/lake.mcap
    bc-log tag sessions/lake.mcap exclude --start 12 --end 15
"""


def main() -> None:
    run_command("bc-log", Command, lambda command: command.run(), ABOUT)  # type: ignore[arg-type]
