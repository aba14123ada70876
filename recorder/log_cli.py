"""`bc-log`: looks after logs."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import tyro
from rich.table import Table

from common import UserError
from common.command import DONE, DONE_BUT_SKIPPED, FAILED, print_error, run_command, warn
from common.errors import as_user_error
from common.location import Location, location
from common.output import plain_table, print_result, print_table
from recorder.log_copy_cli import CopyLogs
from recorder.log_edit_cli import ExportLogs, Merge, Recover, Rewrite, Split, Trim, refuse_fewer, remark_crcs
from recorder.log_flag import FOLDERS, LogOrFolderFlag, LogOrUrlFlag, logs_at
from recorder.log_report import (
    NextStep,
    plain,
    print_checked,
    print_first,
    print_info,
    step_of_check,
    step_of_info,
    step_of_list,
)
from recorder.log_tag_cli import NameRows, warn_stale

if TYPE_CHECKING:
    from recorder.upkeep.log_info import LogInfo

SORTED_BY: Final[dict[str, Callable[[LogInfo], Any]]] = {
    "newest": lambda info: tuple(-ord(character) for character in info.start) or (0,),
    "name": lambda info: info.path,
    "rows": lambda info: -info.rows,
    "duration": lambda info: -info.length_s,
}


@dataclass(frozen=True)
class ListLogs:
    """List sessions and drives, the newest first: time, duration, rows, driver, odd rows."""

    places: Annotated[
        tuple[LogOrFolderFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[FOLDER|LOG ...]")
    ] = ()
    """Logs or folders; by default sessions and drives."""
    sort: Literal["newest", "name", "rows", "duration"] = "newest"
    """Order of the list, largest first."""
    json: bool = False
    """Print one JSON object a log, as `bc-log info --json` does."""

    def run(self) -> int:
        from recorder.upkeep.log_info import describe  # NumPy

        infos, codes = [], [DONE]
        for path in self._logs():
            try:
                infos.append(describe(path))
            except Exception as error:
                codes.append(print_error("bc-log", as_user_error(path, error)))
        infos.sort(key=lambda info: (SORTED_BY[self.sort](info), info.path))
        if self.json:
            for info in infos:
                print_result(info.as_json())
        elif infos:
            print_table(_table(infos))
        codes += [warn(info.notice) for info in infos if info.notice]
        if infos and not self.json:
            print_first([step_of_list(infos)])
        return FAILED if FAILED in codes else max(codes)

    def _logs(self) -> list[Location]:
        folders = [folder for folder in FOLDERS if folder.is_dir()]
        if not self.places and not folders:
            raise UserError("no sessions and no drives here; record one with `bc-record`, or name a folder")
        logs = list(dict.fromkeys(log for place in self.places or folders for log in logs_at(place)))
        if not logs:
            places = ", ".join(str(place) for place in self.places or folders)
            raise UserError(f"{places}: no log in it; record one with `bc-record`")
        return logs


def _table(infos: Sequence[LogInfo]) -> Table:
    headings = ("log", "date, UTC", "min", "rows", "MB", "driven by", "odd", "tags")
    table = plain_table(None, *headings, text={"driven by", "odd", "tags"})
    for info in infos:
        odd = ", ".join(f"{rows:,} {kind.replace('_', ' ')}" for kind, rows in info.odd_rows.items())
        table.add_row(
            plain(location(info.path).name.removesuffix(".mcap")),
            plain(info.start[:16].replace("T", " ")),
            f"{info.length_s / 60:,.1f}",
            f"{info.rows:,}",
            f"{info.size_bytes / 1e6:,.0f}",
            plain(info.driver or "-"),
            "-" if info.odd is None else plain(odd),
            plain(", ".join(sorted({tag.name for tag in info.tags}))),
        )
    return table


@dataclass(frozen=True)
class ShowInfo:
    """Show what logs contain, their origin, and how they were steered. Reads only their ends."""

    logs: Annotated[tuple[LogOrUrlFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]
    """The logs to describe."""
    look: bool = False
    """If the steering's lag is unknown, measure it in up to 1,500 pictures, and keep it next to the
    log."""
    json: bool = False
    """Print one JSON object a log."""

    def run(self) -> int:
        return _each(self.logs, self._one)

    def _one(self, path: Location, steps: list[NextStep]) -> int:
        from recorder.upkeep.log_info import describe  # NumPy

        info = describe(path, look=self.look)
        if self.json:
            print_result(info.as_json())
        else:
            print_info(info)
            steps.append(step_of_info(info))
        code = warn_stale(path, info.stale_tags)
        return warn(info.notice) if info.notice else code


@dataclass(frozen=True)
class Check:
    """Check whole logs: CRCs, indexes, order, gaps, broken, frozen or missing pictures, stuck or contradicting
    steering, values out of range; measure the steering's lag. Exit code 3 if something is wrong."""

    logs: Annotated[tuple[LogOrUrlFlag, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG [LOG ...]")]
    """The logs to check."""
    look: bool = True
    """Do not decode the pictures: several times faster."""
    json: bool = False
    """Print one JSON object a log, with every finding."""

    def run(self) -> int:
        return _each(self.logs, self._one)

    def _one(self, path: Location, steps: list[NextStep]) -> int:
        from recorder.upkeep.check import check
        from recorder.upkeep.log_info import describe

        checked = check(path, look=self.look)
        if self.json:
            result = {
                "path": str(path),
                "messages": checked.messages,
                "pictures_decoded": checked.pictures,
                "has_crcs": checked.has_crcs,
                "meant_gaps": checked.meant_gaps,
                "pauses": checked.pauses,
                "set_back": checked.set_back,
                "findings": [finding._asdict() for finding in checked.findings],
                "odd": [asdict(stretch) for stretch in checked.odd],
                "lag": checked.lag and checked.lag.lag and asdict(checked.lag.lag),
            }
            print_result(json.dumps(result))
        else:
            info = describe(path)
            print_checked(checked, info.tags)
            remark_crcs(path, checked.has_crcs)
            steps.append(step_of_check(info, checked.odd, is_damaged=checked.is_damaged))
        return DONE_BUT_SKIPPED if checked.findings else DONE


Command = (
    Annotated[ListLogs, tyro.conf.subcommand("ls")]
    | Annotated[ShowInfo, tyro.conf.subcommand("info")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Recover, tyro.conf.subcommand("recover")]
    | Annotated[Trim, tyro.conf.subcommand("trim")]
    | Annotated[Merge, tyro.conf.subcommand("merge")]
    | Annotated[Rewrite, tyro.conf.subcommand("rewrite")]
    | Annotated[Split, tyro.conf.subcommand("split")]
    | Annotated[NameRows, tyro.conf.subcommand("tag")]
    | Annotated[CopyLogs, tyro.conf.subcommand("copy")]
    | Annotated[ExportLogs, tyro.conf.subcommand("export")]
)


def _each(logs: tuple[Location, ...], action: Callable[[Location, list[NextStep]], int]) -> int:
    """Do `action` for every log, also after an unreadable one, and print the most important next step; the worst
    of the exit codes."""
    refuse_fewer(logs)
    codes, steps = [], list[NextStep]()
    for path in logs:
        try:
            codes.append(action(path, steps))
        except Exception as error:
            codes.append(print_error("bc-log", as_user_error(path, error)))
    print_first(steps)
    return FAILED if FAILED in codes else max(codes)


ABOUT = """Inspect, check, edit, tag and copy logs.

No log is edited in place. Give a log by path, URL or name: lake is sessions/lake.mcap.

    bc-log ls
    bc-log info lake
    bc-log tag lake exclude --start 12 --end 15
"""


def main() -> None:
    run_command("bc-log", Command, lambda command: command.run(), ABOUT)  # type: ignore[arg-type]
