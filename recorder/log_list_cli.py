"""`bc-log ls`: lists sessions and drives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import tyro
from rich.table import Table

from common import UserError
from common.command import DONE, FAILED, print_error, warn
from common.errors import as_user_error
from common.location import Location, location
from common.output import plain_table, print_result, print_table
from recorder.log.logs_in_folder import logs_at
from recorder.log_flag import FOLDERS, LogOrFolderFlag
from recorder.log_report import plain, print_first, step_of_list

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
