"""A new session: its name, and what `bc-record` and `bc-import` print about its log."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from common.command import warn_skipped
from common.errors import UsageError, counted, printable
from common.output import print_message, print_next, print_result

if TYPE_CHECKING:
    from recorder.sources.imported_rows import Imported

_NOT_IN_FILE_NAMES: Final = '/\\:*?"<>|'  # of one of the systems
_ENDING: Final = re.compile(r"(\.(zip|mcap|csv|db3))+$", re.IGNORECASE)
_MAX_BYTES: Final = 120
_UDACITY_CSV: Final = "driving_log.csv"  # the same in every recording


def make_session(folder: Path, name: str, write: Callable[[Path], Imported]) -> int:
    """Let `write` make the log of a session, and print what is in it. Returns the exit code. Raises UsageError for
    a name that a session cannot have."""
    _check_name(name)
    done = write(folder / f"{name}.mcap")
    code = warn_skipped(done.skipped)
    for recorded in (done, *done.others):
        print_recorded(recorded)
    print_next_index(folder)
    return code


def print_next_index(folder: Path) -> None:
    print_next(f"bc-index --sessions {shlex.quote(str(folder))}" if folder != Path("sessions") else "bc-index")


def print_recorded(done: Imported) -> None:
    from recorder.rows.odd_stretches import odd_advice, odd_lines  # NumPy, Arrow
    from recorder.upkeep.log_info import describe

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


def _check_name(name: str) -> None:
    if not name or name.startswith((".", "-")) or set(name) & set(_NOT_IN_FILE_NAMES) or printable(name) != name:
        raise UsageError(f"{name!r}: not a name for a session; give a plain one, such as lake")
    if name.endswith(".mcap"):
        raise UsageError(f"{name}: give the name without its ending: {shlex.quote(name.removesuffix('.mcap'))}")


def name_of_recording(source: Path) -> str:
    """The name of a recording's session: that of its folder, or of its file."""
    path = Path(os.path.abspath(source))  # noqa: PTH100  (Path.resolve would follow a link to another name)
    return plain_name(path.parent.name if path.name == _UDACITY_CSV else path.name)


def plain_name(name: str) -> str:
    """A plain name for a folder or session, made from a file's name in any language: it needs no quotes."""
    plain = "".join(
        letter if (letter.isprintable() if letter > "\x7f" else letter.isalnum() or letter in "_.-") else " "
        for letter in _ENDING.sub("", name)
    )
    words = "-".join(plain.split())
    return words.encode()[:_MAX_BYTES].decode(errors="ignore").strip("-.") or "recording"
