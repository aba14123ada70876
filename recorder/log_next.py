"""What to do next about logs that were looked at: mend one, exclude what is odd in it, look at it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from common.location import Location, location
from common.output import print_next
from recorder.log.tags import EXCLUDE
from recorder.log_flag import SESSIONS

if TYPE_CHECKING:  # NumPy
    from recorder.rows.odd_stretches import OddStretch
    from recorder.upkeep.log_info import LogInfo

_EXCLUDES: Final = "excludes all that is surely odd"


class NextStep(NamedTuple):
    """A command, and why; of several, the one with the smallest `order` comes next."""

    order: int
    command: str
    why: str = ""


def step_of_info(info: LogInfo) -> NextStep:
    """What to do about a log, by its numbers."""
    from recorder.rows.odd_stretches import exclude_command

    log, left = location(info.path), _left(info)
    if any(stretch.is_sure for stretch in left):
        return NextStep(1, exclude_command(left, log), _EXCLUDES)
    if left:
        return NextStep(2, _command("check", log), "it looks at the pictures of what is perhaps odd")
    return _go_on(log)


def step_of_check(info: LogInfo, odd: Sequence[OddStretch], *, is_damaged: bool) -> NextStep:
    """What to do about a log whose file, rows and pictures were checked, and showed what is `odd`."""
    from recorder.rows.odd_stretches import exclude_command

    log = location(info.path)
    if is_damaged:
        return NextStep(0, _command("recover", log), "it writes what is sound to a new log")
    left = [stretch for stretch in _left(info, odd) if stretch.is_sure]
    return NextStep(1, exclude_command(left, log), _EXCLUDES) if left else _go_on(log)


def print_first(steps: Sequence[NextStep]) -> None:
    """Print the step that comes first, if there is any."""
    if steps:
        print_next(*min(steps, key=lambda step: step.order)[1:])


def step_of_list(logs: Sequence[LogInfo]) -> NextStep:
    """What to do about one of these logs: that with most odd rows, else the newest."""
    rows = {info.path: sum(stretch.rows for stretch in _left(info) if stretch.is_sure) for info in logs}
    odd = max(rows, key=lambda path: rows[path])
    if rows[odd]:
        return NextStep(1, _command("info", location(odd)), "what is odd in it")
    return _go_on(location(max(logs, key=lambda info: info.start).path))


def _left(info: LogInfo, odd: Sequence[OddStretch] | None = None) -> list[OddStretch]:
    """What is odd in a log and not excluded."""
    from recorder.log.tagged_rows import TaggedRows  # NumPy

    return TaggedRows(info.tags, EXCLUDE).left(odd or info.odd or ())


def _go_on(log: Location) -> NextStep:
    """A session is learnt from, a drive looked at."""
    return NextStep(3, "bc-index" if log.parent == SESSIONS else f"bc-play {shlex.quote(str(log))}")


def _command(name: str, log: Location) -> str:
    return f"bc-log {name} {shlex.quote(str(log))}"
