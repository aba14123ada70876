"""Titles and notes that a user gives to recordings, drives and networks.

They change no log and no run: a note is a small file next to the log (NAME.note.json), or in the run's folder.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec

from common import atomic_file
from common.errors import printable
from common.files import session_name
from common.untrusted import json_as
from web.errors import WebError

NOTE_FILE: Final = "note.json"
_MAX_TITLE: Final = 80
_MAX_NOTE: Final = 4000  # characters


class Note(msgspec.Struct, frozen=True):
    title: str = ""
    note: str = ""

    def named(self, name: str) -> str:
        """The title, or the name of what has none."""
        return self.title or name


def read_note(of: Path) -> Note:
    """The note of a log or run; an empty one if it has none, or an unreadable one."""
    try:
        with _path(of).open("rb") as file:
            note = json_as(file.read(16 * _MAX_NOTE), Note) or Note()
    except OSError:
        return Note()
    return Note(printable(note.title)[:_MAX_TITLE], note.note[:_MAX_NOTE])


def write_note(of: Path, title: str, note: str) -> None:
    """Replace the note of a log or run; an empty one is deleted. Raises WebError if it is too long."""
    written = Note(" ".join(title.split()), note.replace("\r\n", "\n").strip())
    if len(written.title) > _MAX_TITLE or len(written.note) > _MAX_NOTE or not written.title.isprintable():
        raise WebError(f"expected a title of {_MAX_TITLE} characters at most, and a note of {_MAX_NOTE}", 422)
    path = _path(of)
    if written == Note():
        path.unlink(missing_ok=True)
        return
    with atomic_file(path, overwrite=True) as part:
        part.write_bytes(msgspec.json.encode(written))


def _path(of: Path) -> Path:
    return of / NOTE_FILE if of.is_dir() else of.with_name(f"{session_name(of)}.{NOTE_FILE}")
