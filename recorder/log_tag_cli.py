"""`bc-log tag`: names rows of a log."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import Annotated, Final

import tyro

from common import UserError
from common.command import DONE, usage_errors, warn
from common.errors import UsageError, counted, did_you_mean, first_of
from common.location import Location
from common.output import ask, print_message, print_next, print_result
from recorder.log.tags import (
    EXCLUDE,
    Tag,
    add_tags,
    check_name,
    names_used,
    read_tags,
    remove_tags,
    tags_by_content,
    tags_path,
)
from recorder.log_edit_cli import rows_of_flags
from recorder.log_flag import LogFlag
from recorder.log_report import rows_of

_MAX_LINES: Final = 200

LogPlace = Annotated[LogFlag, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]


@dataclass(frozen=True)
class NameRows:
    """Tag rows, remove tags, or list them. Tags are in NAME.tags.jsonl next to the log. Rows tagged `exclude` are
    never trained on."""

    log: LogPlace
    """The log to tag."""
    tag: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[TAG]")] = None
    """The tag: `exclude`, `fine` (not odd after all), or any name; without one, list the tags."""
    start: float | None = None
    """First second, counted from the log's first row."""
    end: float | None = None
    """Last second."""
    rows: tuple[int, int] | None = None
    """First and last row, instead of times (all rows: --start 0)."""
    odd: bool = False
    """Tag all stretches that are surely odd; they are listed first."""
    look: bool = False
    """With --odd: also those that only the pictures show."""
    where: Annotated[str | None, tyro.conf.arg(metavar="CONDITION")] = None
    """Tag all rows that meet this condition: "speed_mph < 2 and throttle = 0"."""
    yes: bool = False
    """Do not ask before tagging what --odd or --where finds."""
    remove: bool = False
    """Remove the tag from these rows, or from all."""

    def run(self) -> int:
        from recorder.log.reader import Log  # NumPy

        with Log(self.log) as log:
            if log.problem:
                raise UserError(f"{log.notice}; tag that one")
            fingerprint = log.fingerprint
        if self.tag is None and (self.remove or not self._is_everywhere()):
            raise UsageError("give the name: `bc-log tag LOG NAME --rows FIRST LAST`")
        by_content = tags_by_content(self.log)
        tags = sorted(by_content.pop(fingerprint, ()))
        code = warn_stale(self.log, sum(map(len, by_content.values())))
        if self.tag is not None:
            tags = self._change(self.tag, tags, fingerprint)
        for tag in tags:
            print_result(f"{tag.name}: {rows_of(tag)}")
        if not tags:
            print_message(f"{self.log}: no tags")
        if not self.remove and self.tag not in {tag.name for tag in tags}:
            return code  # nothing was tagged
        if self.tag == EXCLUDE:
            print_next("bc-index", "it leaves out the rows that are tagged so")
        else:
            print_next(f"bc-play {shlex.quote(str(self.log))}")
        return code

    def _is_everywhere(self) -> bool:
        return (self.start, self.end, self.rows, self.where) == (None,) * 4 and not self.odd

    def _chosen(self, name: str) -> list[Tag]:
        if not self.odd and self.where is None:
            return [Tag(*rows_of_flags(self.log, self.start, self.end, self.rows), name)]
        if (self.start, self.end, self.rows) != (None,) * 3 or (self.odd and self.where is not None):
            raise UsageError("give one of --odd, --where, --rows, or --start and --end")
        from common.stretches import stretches
        from recorder.log.reader import Log
        from recorder.log.road_places import states_of
        from recorder.log.tags import fine_rows
        from recorder.rows.condition import log_columns, rows_where
        from recorder.rows.odd_stretches import odd_stretches

        with Log(self.log) as log:
            states = states_of(log)
            odd = odd_stretches(states) if self.odd else []
            if self.look:
                from recorder.seen.picture_stretches import with_pictures  # OpenCV

                odd = with_pictures(log, states, odd)
        if self.where is not None:
            edges = stretches(rows_where(log_columns(states), self.where))
            chosen = [Tag(int(states.row[first]), int(states.row[last]), name) for first, last in edges]
            words = [rows_of(tag) for tag in chosen]
        else:
            sure = [stretch for stretch in odd if stretch.is_sure]
            if not self.remove:
                sure = fine_rows(self.log).untagged(sure)
            chosen = [Tag(stretch.first_row, stretch.last_row, name) for stretch in sure]
            words = [str(stretch) for stretch in sure]
        for line in words[:_MAX_LINES]:
            print_message(line)
        if len(words) > _MAX_LINES:
            print_message(f"and {counted(len(words) - _MAX_LINES, 'more stretch', 'more stretches')}")
        return chosen

    def _is_confirmed(self, chosen: list[Tag]) -> bool:
        if self.yes or self.remove or not (self.odd or self.where is not None):
            return True
        rows = sum(tag.last_row - tag.first_row + 1 for tag in chosen)
        in_all = f"{counted(rows, 'row')} in {counted(len(chosen), 'stretch', 'stretches')}"
        return ask(f"Tag {in_all} {self.tag!r}?") is not False  # without a terminal nobody is asked

    def _notice_of_new(self, name: str) -> str:
        """The notice for a new name; "" for other names. If it may be mistyped, the user is asked first: its rows
        would be trained on."""
        used = names_used(self.log.parent)
        if name in used:
            return ""
        meant = did_you_mean(name, used, "; ")
        notice = f"new tag {name!r}{meant}"
        answer = ask(f"{notice} Give {name!r} all the same?") if meant else None
        if answer is not None and not answer:
            raise UserError("nothing was tagged")
        return "" if answer else notice

    def _change(self, name: str, tags: list[Tag], fingerprint: str) -> list[Tag]:
        with usage_errors(ValueError):
            check_name(name)
        if self.look and not self.odd:
            raise UsageError("--look: give --odd, too")
        if self._is_everywhere() and not self.remove:
            raise UsageError(
                f"{name}: which rows? Give --rows FIRST LAST, --start and --end (--start 0 for all), --where, or"
                " --odd"
            )
        if self._is_everywhere():
            chosen = [tag for tag in tags if tag.name == name]
        else:
            chosen = self._chosen(name)
        if not chosen and not self.remove:
            if self.where is not None:
                raise UserError(f"{self.log}: no row meets this condition; nothing was tagged")
            print_message(f"{self.log}: nothing that is surely odd; nothing was tagged")
            return tags
        if self.remove and not set(chosen) & set(tags):
            raise UserError(f"{self.log}: {_not_tagged(name, tags)}")
        notice = "" if self.remove else self._notice_of_new(name)
        if not self._is_confirmed(chosen):
            raise UserError("nothing was tagged")
        if self.remove:
            removed = sorted(set(chosen) & set(tags))
            remove_tags(self.log, fingerprint, removed)
            for tag in removed:
                print_message(f"removed {tag.name}: {rows_of(tag)}")
        else:
            add_tags(self.log, fingerprint, chosen)
        if notice:
            print_message(notice)  # once it is kept
        return read_tags(self.log, fingerprint)


def _not_tagged(name: str, tags: list[Tag]) -> str:
    if rows := [rows_of(tag) for tag in tags if tag.name == name]:
        return f"no tag {name!r} of exactly these rows, but of {first_of(rows)}; without rows, all are removed"
    names = sorted({tag.name for tag in tags}) or ["none"]
    meant = did_you_mean(name, names)
    return f"no tag {name!r}; {meant or f'its tags: {first_of(names)}'}"


def warn_stale(path: Location, count: int) -> int:
    """Warn of tags for an earlier content of the log; the exit code."""
    if not count:
        return DONE
    tags = f"{counted(count, 'tag is', 'tags are')} of another content of {path.name} and"
    return warn(f"{tags_path(path)}: {tags} {'does' if count == 1 else 'do'} not count")
