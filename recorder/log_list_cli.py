"""`bc-log ls`: lists sessions and drives."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import tyro
from rich.markup import escape
from rich.table import Table

from common import UserError
from common.command import DONE, print_error, warn
from common.errors import printable
from common.output import print_result, print_table
from recorder.log.log_info import LogInfo, describe
from recorder.log.row_quality import ROW_FLAGS
from recorder.log.topics import VEHICLE

FOLDERS: Final = (Path("sessions"), Path("drives"))

SORTED_BY: Final[dict[str, Callable[[LogInfo], Any]]] = {
    "newest": lambda info: tuple(-ord(character) for character in info.start),
    "name": lambda info: info.path,
    "rows": lambda info: -_rows(info),
    "duration": lambda info: -_seconds(info),
}


@dataclass(frozen=True)
class ListLogs:
    """List sessions and drives, the newest first: when, how long, how many rows, who drove, what is odd."""

    places: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[FOLDER|LOG ...]")] = ()
    """Folders of logs, or logs; by default those in sessions and drives."""
    sort: Literal["newest", "name", "rows", "duration"] = "newest"
    """By what to order them; most first."""
    json: bool = False
    """One JSON object a log, as `bc-log info --json` has it, and no table."""

    def run(self) -> int:
        found, codes = [], [DONE]
        for path in self._logs():
            try:
                found.append(describe(path))
            except UserError as error:
                codes.append(print_error("bc-log", error))
        found.sort(key=lambda info: (SORTED_BY[self.sort](info), info.path))
        if self.json:
            for info in found:
                print_result(json.dumps(dataclasses.asdict(info), allow_nan=False))
        elif found:
            print_table(_table(found))
        return max([*codes, *(warn(info.notice) for info in found if info.notice)])

    def _logs(self) -> list[Path]:
        folders = [folder for folder in FOLDERS if folder.is_dir()]
        if not self.places and not folders:
            raise UserError("no sessions and no drives here; record one with `bc-record`, or name a folder")
        logs = [log for place in self.places or folders for log in _logs_of(place)]
        if not logs:
            places = ", ".join(str(place) for place in self.places or folders)
            raise UserError(f"{places}: no log in it; record one with `bc-record`")
        return logs


def _logs_of(place: Path) -> Iterator[Path]:
    """The finished logs of a folder and those that are not; or the log itself."""
    if place.is_dir():
        yield from sorted((*place.glob("*.mcap"), *place.glob("*.mcap.*.part")))
    else:
        yield place


def _table(found: Sequence[LogInfo]) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("log", "begun, UTC", "min", "rows", "MB", "driven by", "odd", "tags"):
        is_number = heading in ("min", "rows", "MB", "odd")
        no_wrap = is_number or heading == "begun, UTC"
        table.add_column(heading, justify="right" if is_number else "left", no_wrap=no_wrap, overflow="fold")
    for info in found:
        odd = sum((info.flags or {}).get(flag, 0) for flag in ROW_FLAGS if flag != "gap")
        table.add_row(
            _plain(Path(info.path).name.removesuffix(".mcap")),
            _plain(info.start[:16].replace("T", " ")),
            f"{_seconds(info) / 60:,.1f}",
            f"{_rows(info):,}",
            f"{info.size_bytes / 1e6:,.0f}",
            _plain(_driver(info)),
            f"{odd:,}" if info.flags is not None else "-",
            _plain(", ".join(sorted({tag.name for tag in info.tags}))),
        )
    return table


def _driver(info: LogInfo) -> str:
    """The run that drove, or else who did or where it comes from, as far as the log says."""
    names = (info.session.get(name, "") for name in ("run", "driver", "source"))
    return next((name for name in names if name), "-")


def _seconds(info: LogInfo) -> float:
    return info.duration_s if info.driven_s is None else info.driven_s


def _rows(info: LogInfo) -> int:
    return next((topic.messages for topic in info.topics if topic.topic == VEHICLE), 0)


def _plain(text: str) -> str:
    return escape(printable(text))
