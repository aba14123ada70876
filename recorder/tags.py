"""Names for stretches of a log ("recovery", "exclude", anything), kept beside it in NAME.tags.jsonl.

Each line adds or removes one: a journal that is only ever appended to, so that two people who tag at once, or
a crash, lose nothing. A line holds for one content of the log, by its fingerprint: a log that was recorded anew
under the same name does not inherit the old one's tags.
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

from recorder.errors import LogError

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

EXCLUDE: Final = "exclude"
"""Rows with this tag are never trained on."""
_LONGEST_NAME: Final = 64
_MOST_BYTES: Final = 1 << 24


@dataclass(frozen=True, order=True)
class Tag:
    """A name for the rows from `first_row` to `last_row`, both included."""

    first_row: int
    last_row: int
    name: str


def tags_path(log: Path) -> Path:
    return log.with_name(f"{log.name.removesuffix('.mcap')}.tags.jsonl")


def read_tags(log: Path, fingerprint: str) -> list[Tag]:
    """The tags of the log with this fingerprint, by their rows. Raises LogError for a damaged file."""
    tags: set[Tag] = set()
    for number, line in enumerate(_lines(log), start=1):
        try:
            entry = json.loads(line)
            (action,) = {"add", "remove"} & entry.keys()
            first_row, last_row = map(_row, entry["rows"])
            tag = _checked(Tag(first_row, last_row, check_name(entry[action])))
            if entry["log"] != fingerprint:
                continue
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise LogError(f"{tags_path(log)}: line {number} is not a tag; mend or remove it") from None
        if action == "add":
            tags.add(tag)
        else:
            tags.discard(tag)
    return sorted(tags)


def add_tag(log: Path, fingerprint: str, tag: Tag) -> None:
    """Raises LogError for a name or rows that no tag can have, or if the file cannot be written."""
    _append(log, "add", fingerprint, tag)


def remove_tag(log: Path, fingerprint: str, tag: Tag) -> None:
    """Raises what `add_tag` does; removing a tag that is not there changes nothing."""
    _append(log, "remove", fingerprint, tag)


def check_name(name: object) -> str:
    """A tag's name. Raises ValueError if it is empty, too long, or not printable."""
    if not isinstance(name, str) or not name.strip() or len(name) > _LONGEST_NAME or not name.isprintable():
        raise ValueError(f"{name!r} is not a name for a tag: 1 to {_LONGEST_NAME} printable characters")
    return name


def _row(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**32:
        raise ValueError(f"{value!r} is not a row")
    return value


def _checked(tag: Tag) -> Tag:
    check_name(tag.name)
    if _row(tag.first_row) > _row(tag.last_row):
        raise ValueError(f"rows {tag.first_row} to {tag.last_row} are not a stretch")
    return tag


def _lines(log: Path) -> list[str]:
    path = _plain(tags_path(log))
    try:
        with path.open("rb") as stream:
            data = stream.read(_MOST_BYTES + 1)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from None
    if len(data) > _MOST_BYTES:
        raise LogError(f"{path}: larger than {_MOST_BYTES:,} bytes, which no tags are")
    whole = data[: data.rfind(b"\n") + 1]
    return whole.decode("utf-8", "replace").splitlines()


def _append(log: Path, action: str, fingerprint: str, tag: Tag) -> None:
    path = _plain(tags_path(log))
    try:
        _checked(tag)
    except ValueError as error:
        raise LogError(f"{path}: {error}") from None
    entry: dict[str, Any] = {action: tag.name, "rows": [tag.first_row, tag.last_row], "log": fingerprint}
    line = json.dumps(entry, ensure_ascii=False).encode() + b"\n"
    try:
        with path.open("ab+") as stream:
            _lock(stream)  # until it is closed: what another one is writing must not be taken for cut off
            stream.seek(0)
            data = stream.read()
            stream.truncate(data.rfind(b"\n") + 1)  # what a crash cut off was never confirmed to anybody
            stream.write(line)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        raise LogError(f"{path}: cannot be written ({error.strerror})") from None


def _plain(path: Path) -> Path:
    """A link that came with somebody's logs could lead to any file of this machine."""
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise LogError(f"{path}: not a plain file; remove it")
    return path


def _lock(stream: IO[bytes]) -> None:
    if sys.platform == "win32":
        stream.seek(_MOST_BYTES)  # behind all lines, because nobody can read what is locked there
        msvcrt.locking(stream.fileno(), msvcrt.LK_LOCK, 1)
    else:
        fcntl.flock(stream, fcntl.LOCK_EX)
