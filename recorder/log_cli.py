"""`bc-log`: looks after logs."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from common import Skipped, UserError
from common.command import DONE, DONE_BUT_SKIPPED, run_command, warn, warn_skipped
from recorder.check import Checked, check
from recorder.edit import Written, merge, recover, recovered_name, rows_between, split, trim
from recorder.info import Info, describe
from recorder.log import Log
from recorder.tags import Tag, add_tag, check_name, read_tags, remove_tag

LogPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
MOST_PLACES = 6


@dataclass(frozen=True)
class ShowInfo:
    """What a log holds and where it comes from; reads its end only, so it is quick however long the log is."""

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]
    """The logs to describe."""
    json: bool = False
    """One JSON object a log, and no table."""

    def run(self) -> int:
        code = DONE
        for path in _some(self.logs):
            info = describe(path)
            if info.notice:
                code = warn(info.notice)
            if self.json:
                print(json.dumps(dataclasses.asdict(info)))
            else:
                _print_info(info)
        return code


@dataclass(frozen=True)
class Check:
    """Read logs through and say what is wrong: CRCs, indexes, order; pictures that do not decode or are frozen,
    rows without one, gaps, stuck steering, values out of range. Exit code 3 if something was found."""

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]
    """The logs to look through."""
    look: bool = True
    """Decode every picture; --no-look leaves that out and is several times faster."""
    json: bool = False
    """One JSON object a log, with every finding."""

    def run(self) -> int:
        code = DONE
        for path in _some(self.logs):
            checked = check(path, look=self.look)
            if checked.findings:
                code = DONE_BUT_SKIPPED
            if self.json:
                found = [finding._asdict() for finding in checked.findings]
                told = {"path": str(path), "messages": checked.messages, "pictures_decoded": checked.pictures}
                print(json.dumps({**told, "findings": found}))
            else:
                _print_checked(checked)
        return code


@dataclass(frozen=True)
class Recover:
    """Make a finished log out of one that is not (its recording was killed), or out of a damaged one. The original
    stays. Everything is kept whose CRC holds; what is lost is named, with exit code 3."""

    log: LogPath
    """The unfinished or damaged log."""
    to: Path | None = None
    """The new log; by default NAME.mcap for NAME.mcap.XXXXXX.part, else NAME.recovered.mcap."""
    force: bool = False
    """Replace a file of the new log's name."""

    def run(self) -> int:
        return _written(recover(self.log, self.to or recovered_name(self.log), overwrite=self.force))


@dataclass(frozen=True)
class Trim:
    """Write a part of a log to a new one. Rows keep their numbers."""

    log: LogPath
    """The log to take a part of."""
    to: Path
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
        rows, notice = _stretch(self.log, self.start, self.end, self.rows)
        return _noted(notice, _written(trim(self.log, self.to, rows, overwrite=self.force)))


@dataclass(frozen=True)
class Merge:
    """Write several logs into one new log, in the order given; its rows are numbered anew."""

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG LOG [LOG ...]")]
    """The logs to merge."""
    to: Path
    """The new log."""
    force: bool = False
    """Replace a file of the new log's name."""

    def run(self) -> int:
        notices = [notice for log in _some(self.logs, 2) if (notice := _notice(log))]
        return _noted("\n".join(notices), _written(merge(self.logs, self.to, overwrite=self.force)))


@dataclass(frozen=True)
class Split:
    """Write each drive of a log to a new log of its own: NAME-1.mcap, NAME-2.mcap and so on. A new drive begins
    after a gap of more than a second, or where time goes back."""

    log: LogPath
    """The log to split."""
    to: Path | None = None
    """Folder for the new logs; by default that of the log."""
    force: bool = False
    """Replace files of the new logs' names."""

    def run(self) -> int:
        notice = _notice(self.log)
        for written in split(self.log, self.to or self.log.parent, overwrite=self.force):
            _written(written)
        return _noted(notice, DONE)


@dataclass(frozen=True)
class NameRows:
    """Name a stretch of a log, or take the name away again. Names are kept beside the log, in NAME.tags.jsonl;
    rows tagged `exclude` are never trained on. Without a name, the tags are listed."""

    log: LogPath
    """The log whose rows get a name."""
    tag: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[TAG]")] = None
    """The name: `exclude`, `recovery`, anything."""
    start: float | None = None
    """From this second on, counted from the log's first row."""
    end: float | None = None
    """Up to this second."""
    rows: tuple[int, int] | None = None
    """The first and the last row, instead of times. Without rows or times: the whole log."""
    remove: bool = False
    """Remove this name: from exactly the rows that are given, or wherever it is."""

    def run(self) -> int:
        with Log(self.log) as log:
            if log.problem:
                raise UserError(f"{log.notice}; tag that one")
            fingerprint = log.fingerprint
        tags = read_tags(self.log, fingerprint)
        if self.tag is not None:
            tags = self._change(self.tag, tags, fingerprint)
        for tag in tags:
            print(f"{tag.name}: rows {tag.first_row} to {tag.last_row}")
        return DONE

    def _change(self, name: str, tags: list[Tag], fingerprint: str) -> list[Tag]:
        try:
            check_name(name)
        except ValueError as error:
            raise UserError(str(error)) from None
        is_whole = self.start is None and self.end is None and self.rows is None
        if self.remove and is_whole:
            chosen = [tag for tag in tags if tag.name == name]
        else:
            rows, _ = _stretch(self.log, self.start, self.end, self.rows)
            chosen = [Tag(*rows, name)]
        if self.remove and not set(chosen) & set(tags):
            held = ", ".join(f"{tag.name} (rows {tag.first_row} to {tag.last_row})" for tag in tags) or "none"
            raise UserError(f"{self.log}: no such tag {name!r}; its tags: {held}")
        for tag in chosen:
            (remove_tag if self.remove else add_tag)(self.log, fingerprint, tag)
        return read_tags(self.log, fingerprint)


Command = (
    Annotated[ShowInfo, tyro.conf.subcommand("info")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Recover, tyro.conf.subcommand("recover")]
    | Annotated[Trim, tyro.conf.subcommand("trim")]
    | Annotated[Merge, tyro.conf.subcommand("merge")]
    | Annotated[Split, tyro.conf.subcommand("split")]
    | Annotated[NameRows, tyro.conf.subcommand("tag")]
)


def _some(logs: tuple[Path, ...], least: int = 1) -> tuple[Path, ...]:
    if len(logs) < least:
        raise UserError(f"give at least {least} log{'s' if least > 1 else ''}, such as sessions/lake.mcap")
    return logs


def _notice(path: Path) -> str:
    with Log(path) as log:
        return log.notice


def _noted(notice: str, code: int) -> int:
    return warn(notice) if notice else code


def _stretch(
    path: Path, start_s: float | None, end_s: float | None, rows: tuple[int, int] | None
) -> tuple[tuple[int, int], str]:
    """The rows that the flags name, and the notice of an unfinished log."""
    if rows is not None and (start_s is not None or end_s is not None):
        raise UserError("give either --rows, or --start and --end")
    with Log(path) as log:
        if rows is None:
            rows = rows_between(log, 0.0 if start_s is None else start_s, float("inf") if end_s is None else end_s)
        return rows, log.notice


def _written(written: Written) -> int:
    code = warn_skipped(written.skipped)
    size_mb = written.path.stat().st_size / 1e6
    print(f"{written.path}: {written.rows:,} rows, {written.messages:,} messages, {size_mb:.1f} MB")
    return code


def _print_info(info: Info) -> None:
    console = Console(highlight=False)
    console.print(
        f"[bold]{escape(info.path)}[/]: {info.duration_s:,.1f} s, {info.size_bytes / 1e6:,.1f} MB, {info.start}"
    )
    table = Table("topic", "schema", "messages", "a second")
    for topic in info.topics:
        table.add_row(escape(topic.topic), escape(topic.schema), f"{topic.messages:,}", f"{topic.per_second:.1f}")
    console.print(table)
    for name, value in sorted(info.session.items()):
        console.print(f"  {escape(name)}: {escape(value)}")
    flagged = ", ".join(f"{count:,} rows {flag}" for flag, count in info.flags.items() if count and flag != "gap")
    if info.drives:
        console.print(f"  {info.drives} drive{'s' if info.drives > 1 else ''}; {flagged or 'no odd rows'}")
    for stretch in info.stretches[:MOST_PLACES]:
        console.print(
            f"    {escape(stretch.flag)}: rows {stretch.first_row} to {stretch.last_row},"
            f" {stretch.begin_s:.1f} to {stretch.end_s:.1f} s"
        )
    if len(info.stretches) > MOST_PLACES:
        console.print(f"    and {len(info.stretches) - MOST_PLACES} more stretches (--json lists them)")
    for tag in info.tags:
        console.print(f"  tag {escape(tag.name)}: rows {tag.first_row} to {tag.last_row}")


def _print_checked(checked: Checked) -> None:
    looked = f", {checked.pictures:,} pictures decoded" if checked.pictures else ""
    print(f"{checked.path}: {checked.messages:,} messages{looked}: {_verdict(checked)}")
    by_kind = Skipped()
    for finding in checked.findings:
        by_kind.add(finding.kind, finding.where)
    for line in by_kind.lines(MOST_PLACES):
        print(f"  {line}")


def _verdict(checked: Checked) -> str:
    count = len(checked.findings)
    return f"{count:,} finding{'s' if count > 1 else ''}" if count else "nothing wrong"


ABOUT = """Look after logs: what is in one, is it sound, make new ones of it, name stretches of it.

Nothing edits a log in place.

    bc-log info sessions/lake.mcap
    bc-log tag sessions/lake.mcap exclude --start 12 --end 15
"""


def main() -> None:
    run_command("bc-log", Command, lambda command: command.run(), ABOUT)  # type: ignore[arg-type]
