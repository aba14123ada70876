"""What `bc-record` and `bc-import` print about a recording."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

from common.command import warn_skipped
from common.errors import counted
from common.output import print_message, print_next, print_result
from recorder.rows.odd_stretches import odd_advice, odd_lines
from recorder.sources.imported_rows import Imported
from recorder.upkeep.log_info import describe


def make_session(log: Path, write: Callable[[Path], Imported]) -> int:
    """Let `write` make the log of a session, and print what is in it. Returns the exit code."""
    done = write(log)
    code = warn_skipped(done.skipped)
    for recorded in (done, *done.others):
        _print_recorded(recorded)
    folder = done.path.parent
    print_next(f"bc-index --sessions {shlex.quote(str(folder))}" if folder != Path("sessions") else "bc-index")
    return code


def _print_recorded(done: Imported) -> None:
    """Print what is in a log, and what is perhaps odd."""
    for notice in done.notices:
        print_message(notice)
    size_mb = done.path.stat().st_size / 1e6
    print_result(
        f"{done.path}: {counted(done.rows, 'row')}, {counted(done.pictures, 'picture')}, {size_mb:,.1f} MB"
    )
    info = describe(done.path, with_tags=False)
    odd = info.odd or ()
    for line in odd_lines(odd):
        print_message(line, heading="odd:", style="yellow")
    for line in odd_advice(odd, done.path):
        print_message(line)
