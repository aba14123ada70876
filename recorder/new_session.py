"""What `bc-record` and `bc-import` do around a recording: its place, printed lines, its copy in a store."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

from common.command import warn_skipped
from common.errors import UsageError, counted
from common.location import Location, Url, local_path
from common.output import print_message, print_next, print_result
from recorder.log_copy_cli import copy_recording, refuse_copying, refuse_taken_name
from recorder.rows.odd_stretches import odd_advice, odd_lines
from recorder.sources.imported_rows import Imported
from recorder.upkeep.log_info import describe


def make_session(
    name: str,
    write: Callable[[Path], Imported],
    *,
    sessions: Location,
    copy_to: Location | None,
    force: bool,
    prog: str,
) -> int:
    """Let `write` make the log of a session, print what is in it, and copy it to a store if a flag says so.

    Returns the exit code. Raises UserError, before `write`, if the store cannot take the log.
    """
    if isinstance(sessions, Url):
        if copy_to is not None:
            raise UsageError(f"--sessions {sessions}: the log is already copied there: leave out --copy-to")
        refuse_copying(sessions)
        refuse_taken_name(sessions / f"{name}.mcap", force)
        sessions, copy_to = Path("sessions"), sessions
    elif copy_to is not None:
        refuse_copying(copy_to)
    done = write(local_path(sessions) / f"{name}.mcap")
    code = warn_skipped(done.skipped)
    for recorded in (done, *done.others):
        _print_recorded(recorded)
        if copy_to is not None:
            code = max(code, copy_recording(recorded.path, copy_to, force, prog=prog))
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
