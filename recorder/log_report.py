"""The output of `bc-log`: the contents of a log, its findings, new logs, and the next step."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from rich.markup import escape
from rich.table import Table

from common import Skipped
from common.command import warn, warn_skipped
from common.errors import counted, printable
from common.location import Location, Url, location
from common.output import print_next, print_result, print_table
from common.steering_unit import DEGREES, FULL_LOCK
from recorder.log.tags import EXCLUDE, Tag, TaggedRows
from recorder.log_flag import SESSIONS
from recorder.topics import VEHICLE

if TYPE_CHECKING:  # NumPy
    from recorder.rows.odd_stretches import OddStretch
    from recorder.upkeep.check import Checked
    from recorder.upkeep.derived_log import Written
    from recorder.upkeep.log_info import LogInfo

MAX_PLACES: Final = 6  # named for each kind; --json names all
_LONG_VALUE: Final = 400  # characters
_EXCLUDES: Final = "excludes all that is surely odd"


def print_info(info: LogInfo) -> None:
    from recorder.log.session_car import is_angle_unknown
    from recorder.rows.label_plan import NOT_MEASURED
    from recorder.rows.steering_habits import steering_line

    driven = f", {info.driven_s:,.1f} s driven" if info.driven_s is not None else ""
    size = f"{info.size_bytes / 1e6:,.1f} MB"
    start = info.start and f", {info.start}"
    print_table(f"[bold]{plain(info.path)}[/]: {info.duration_s:,.1f} s{driven}, {size}{start}")
    table = Table("topic", "schema", "messages", "a second")
    for topic in info.topics:
        table.add_row(plain(topic.topic), plain(topic.schema), f"{topic.messages:,}", f"{topic.per_second:,.1f}")
    print_table(table)
    for name, value in sorted(info.session.items()):
        print_table(f"  {plain(name)}: {plain(_in_short(value))}")
    _print_drives(info)
    if info.steering is not None and info.steering.rows:
        unit = FULL_LOCK if is_angle_unknown(info.session) else DEGREES
        measures = f"; `bc-log check {plain(shlex.quote(info.path))}` measures it" * (NOT_MEASURED in info.labels)
        print_table(f"  {steering_line(info.steering, info.lag, unit)}", f"  labels: {info.labels}{measures}")
    for topic_name, sizes in info.picture_sizes.items():
        print_table(f"  pictures of several sizes on {plain(topic_name)}: {plain(sizes)}")
    for tag in info.tags:
        print_table(f"  tag {plain(tag.name)}: {rows_of(tag)}")


def print_checked(checked: Checked, tags: Sequence[Tag]) -> None:
    from recorder.rows.causes import CAUSES
    from recorder.rows.steering_habits import lag_in_words

    decoded = f", {counted(checked.pictures, 'picture')} decoded" if checked.pictures else ""
    verdict = counted(len(checked.findings), "finding") if checked.findings else "nothing wrong"
    print_result(f"{checked.path}: {counted(checked.messages, 'message')}{decoded}: {verdict}")
    places, odd_kinds = Skipped(), {cause.several for cause in CAUSES.values()}
    for finding in checked.findings:
        if finding.kind not in odd_kinds:  # odd stretches are named below, with their causes
            places.add(finding.kind, finding.where)
    for line in places.lines(MAX_PLACES):
        print_result(f"  {line}")
    if checked.lag is not None:
        words = lag_in_words(checked.lag.lag) if checked.lag.lag else "its pictures do not show the lag"
        print_result(f"  {words}")
    odd = _odd_lines(checked.odd, tags, checked.path, is_looked=checked.pictures > 0)
    print_result(*(f"  {line}" for line in odd))
    meant = Skipped()
    for where in checked.meant_gaps:
        meant.add("gaps in time that its events explain, so nothing is lost", where)
    for where in checked.pauses:
        meant.add("pauses of the recording; a new drive begins after each", where)
    for where in checked.set_back:
        meant.add("jumps back in time; a new drive begins after each", where)
    for line in meant.lines(MAX_PLACES):
        print_result(f"  {line}")


def print_written(written: Written) -> int:
    """Print what a new log holds and lacks; the exit code, 3 if it lacks something."""
    code = max([warn_skipped(written.skipped), *map(warn, written.notices)])
    size_mb = written.path.stat().st_size / 1e6
    contents = f"{counted(written.rows, 'row')}, {counted(written.messages, 'message')}, {size_mb:,.1f} MB"
    print_result(f"{written.path}: {contents}")
    return code


def rows_of(tag: Tag) -> str:
    return f"rows {tag.first_row} to {tag.last_row}"


def _print_drives(info: LogInfo) -> None:
    if info.drives is None or info.flags is None:
        if not info.is_ours:
            print_table("  written by another program: `bc-import FILE NAME` imports it")
        elif info.session.get("source") != "prediction" and not any(
            topic.topic == VEHICLE and topic.messages for topic in info.topics
        ):
            print_table("  no rows: nothing was driven")
    elif info.drives:
        print_table(f"  {counted(info.drives, 'drive')}; {'odd:' if info.odd else 'no odd rows'}")
        print_result(*(f"    {line}" for line in _odd_lines(info.odd or (), info.tags, location(info.path))))
    if info.meant_gaps:
        print_table(f"  {counted(len(info.meant_gaps), 'gap')} that its events explain, so nothing is lost there")
    gaps = [
        stretch for stretch in info.stretches if stretch.flag == "gap" and stretch.last_row not in info.meant_gaps
    ]
    for gap in gaps[:MAX_PLACES]:
        goes_back = " (time goes back)" if gap.end_s < gap.begin_s else ""
        print_table(
            f"    gap: rows {gap.first_row} to {gap.last_row}, {gap.begin_s:.1f} to {gap.end_s:.1f} s{goes_back}"
        )
    if len(gaps) > MAX_PLACES:
        print_table(f"    and {counted(len(gaps) - MAX_PLACES, 'more gap')} (--json lists them)")


def _odd_lines(
    odd: Sequence[OddStretch], tags: Sequence[Tag], log: Location, *, is_looked: bool = False
) -> list[str]:
    """The odd stretches of a log, and, on this machine, what to do about them; excluded ones are only counted.
    `is_looked`: as in `odd_advice`."""
    from recorder.rows.odd_stretches import odd_advice, odd_lines

    left = TaggedRows(tags, EXCLUDE).untagged(odd)
    excluded = len(odd) - len(left)
    lines = [f"{counted(excluded, 'odd stretch is', 'odd stretches are')} excluded"] if excluded else []
    advice = odd_advice(left, log, is_looked=is_looked) if isinstance(log, Path) else []
    return [*odd_lines(left), *lines, *advice]


def _in_short(value: str) -> str:
    return value if len(value) <= _LONG_VALUE else f"{value[:_LONG_VALUE]} ... (--json has all)"


def plain(text: str) -> str:
    """Untrusted text for a table: without markup, in one line."""
    return escape(printable(text))


class NextStep(NamedTuple):
    """A command and its reason. Of several, the one with the smallest `order` is printed."""

    order: int
    command: str
    why: str = ""


def step_of_info(info: LogInfo) -> NextStep:
    from recorder.rows.odd_stretches import exclude_command

    log, left = location(info.path), _left(info, info.odd)
    if isinstance(log, Url):
        return _go_on(info)
    if any(stretch.is_sure for stretch in left):
        return NextStep(1, exclude_command(left, log), _EXCLUDES)
    if left:
        return NextStep(2, _command("check", log), "it checks the pictures of perhaps odd stretches")
    return _go_on(info)


def step_of_check(info: LogInfo, odd: Sequence[OddStretch], *, is_damaged: bool) -> NextStep:
    """The next step for a log after its check, which found the stretches `odd`."""
    from recorder.rows.odd_stretches import exclude_command

    log = location(info.path)
    if isinstance(log, Url):
        return _go_on(info)
    if is_damaged:
        return NextStep(0, _command("recover", log), "it writes the sound parts to a new log")
    left = [stretch for stretch in _left(info, odd) if stretch.is_sure]
    return NextStep(1, exclude_command(left, log), _EXCLUDES) if left else _go_on(info)


def print_first(steps: Sequence[NextStep]) -> None:
    if steps:
        print_next(*min(steps, key=lambda step: step.order)[1:])


def step_of_list(logs: Sequence[LogInfo]) -> NextStep:
    """The next step for the log with the most odd rows, or for the newest log."""
    rows = {info.path: sum(stretch.rows for stretch in _left(info, info.odd) if stretch.is_sure) for info in logs}
    odd = max(rows, key=lambda path: rows[path])
    if rows[odd]:
        return NextStep(1, _command("info", location(odd)), "it shows the odd stretches")
    return _go_on(max(logs, key=lambda info: info.start))


def _left(info: LogInfo, odd: Sequence[OddStretch] | None) -> list[OddStretch]:
    """The stretches `odd` of a log that are not excluded."""
    return TaggedRows(info.tags, EXCLUDE).untagged(odd or ())


def _go_on(info: LogInfo) -> NextStep:
    """The next step for a log without problems: index a session, play a drive; bring a log in a store here."""
    log = location(info.path)
    if isinstance(log, Url):
        return NextStep(3, f"bc-copy {shlex.quote(str(log))} sessions", "to show, tag or recover it here")
    if not any(topic.messages for topic in info.topics):
        return NextStep(4, "bc-record NAME", f"{log} is empty")
    return NextStep(3, "bc-index" if log.parent == SESSIONS else f"bc-play {shlex.quote(str(log))}")


def _command(name: str, log: Location) -> str:
    return f"bc-log {name} {shlex.quote(str(log))}"
