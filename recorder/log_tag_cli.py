"""`bc-log tag`: names rows of a log."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import tyro

from common import UserError
from common.command import DONE, usage_errors, warn
from common.errors import UsageError, counted, did_you_mean
from common.location import Location
from common.output import ask, print_message, print_next, print_result
from common.stretches import stretches
from recorder.log.reader import Log
from recorder.log.row_condition import rows_where
from recorder.log.row_quality import SURE_FLAGS, States, row_flags
from recorder.log.tags import (
    EXCLUDE,
    Tag,
    add_tag,
    check_name,
    names_used,
    read_tags,
    remove_tag,
    tags_by_content,
    tags_path,
)
from recorder.log_flag import LogFlag
from recorder.log_report import rows_of
from recorder.log_row_flags import rows_of_flags

LogPlace = Annotated[LogFlag, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]


@dataclass(frozen=True)
class NameRows:
    """Tag rows, remove tags, or list them. Tags are in NAME.tags.jsonl next to the log. Rows tagged `exclude` are
    never trained on."""

    log: LogPlace
    """The log to tag."""
    tag: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[TAG]")] = None
    """The tag: `exclude`, `recovery`, or any name; none: list tags."""
    start: float | None = None
    """First second, counted from the log's first row."""
    end: float | None = None
    """Last second."""
    rows: tuple[int, int] | None = None
    """First and last row, instead of times; the whole log: --start 0."""
    odd: bool = False
    """Tag all rows of crashes, driving backwards, or values out of range."""
    where: str | None = None
    """Tag all rows that meet this condition: "speed_mph < 2 and throttle == 0"."""
    remove: bool = False
    """Remove the tag from these rows, or from all."""

    def run(self) -> int:
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
        if self.tag == EXCLUDE:
            print_next("bc-index", "training then leaves out the rows that are tagged so, and no others")
        elif self.tag is not None:
            print_next(f"bc-play {shlex.quote(str(self.log))}")
        return code

    def _is_everywhere(self) -> bool:
        return not self._is_found and self.start is None and self.end is None and self.rows is None

    @property
    def _is_found(self) -> bool:
        """Rows are looked for, and not given."""
        return self.odd or self.where is not None

    def _found(self, name: str) -> list[Tag]:
        """The stretches that --odd or --where find; listed, and asked about at a terminal."""
        with Log(self.log) as log:
            states = States.of(log.vehicle())
        if self.where is not None:
            mask = rows_where(states, self.where)
        else:
            flags = row_flags(states)
            mask = np.logical_or.reduce([flags[flag] for flag in SURE_FLAGS])
        chosen = [Tag(int(states.row[a]), int(states.row[b]), name) for a, b in stretches(mask)]
        if not chosen:
            raise UserError(f"{self.log}: no such row")
        for tag in chosen:
            print_message(f"{name}: {rows_of(tag)}")
        if not self.remove and ask(f"Tag these {counted(int(mask.sum()), 'row')} {name!r}?") is False:
            raise UserError("nothing was tagged")
        return chosen

    def _notice_of_new(self, name: str) -> str:
        """The notice for a name that nobody has used yet; "" for any other. Where it is perhaps mistyped, a person
        is asked first: its rows would be trained on."""
        used = names_used(self.log.parent)
        if name in used:
            return ""
        meant = did_you_mean(name, used)
        notice = f"new tag {name!r}" + (f"; {meant}" if meant else "")
        answer = ask(f"{notice} Give {name!r} all the same?") if meant else None
        if answer is not None and not answer:
            raise UserError("nothing was tagged")
        return "" if answer else notice

    def _change(self, name: str, tags: list[Tag], fingerprint: str) -> list[Tag]:
        with usage_errors(ValueError):
            check_name(name)
        if self._is_everywhere() and not self.remove:
            raise UsageError(
                f"{name}: which rows? Give --rows FIRST LAST, --start and --end (all: --start 0), --odd or --where"
            )
        if self._is_found:
            if (self.odd and self.where is not None) or (self.start, self.end, self.rows) != (None, None, None):
                raise UsageError("give one of --odd, --where, --rows, and --start with --end")
            chosen = self._found(name)
        elif self._is_everywhere():
            chosen = [tag for tag in tags if tag.name == name]
        else:
            chosen = [Tag(*rows_of_flags(self.log, self.start, self.end, self.rows), name)]
        if self._is_found and self.remove:
            chosen = [tag for tag in chosen if tag in tags]
        if self.remove and not set(chosen) & set(tags):
            held = ", ".join(f"{tag.name} ({rows_of(tag)})" for tag in tags) or "none"
            raise UserError(f"{self.log}: no tag {name!r} of exactly these rows; its tags: {held}")
        notice = "" if self.remove else self._notice_of_new(name)
        for tag in chosen:
            (remove_tag if self.remove else add_tag)(self.log, fingerprint, tag)
            if self.remove:
                print_message(f"removed {tag.name}: {rows_of(tag)}")
        if notice:
            print_message(notice)  # once it is kept
        return read_tags(self.log, fingerprint)


def warn_stale(path: Location, count: int) -> int:
    """Tags of what had this name before are not lost in silence."""
    if not count:
        return DONE
    tags = f"{counted(count, 'tag is', 'tags are')} of another content of {path.name} and"
    return warn(f"{tags_path(path)}: {tags} {'does' if count == 1 else 'do'} not count")
