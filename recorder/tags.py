"""Names for stretches of a log ("recovery", "exclude", anything), kept beside it in NAME.tags.jsonl.

Each line adds or removes one: a journal that is only ever appended to, so that two people who tag at once, or
a crash, lose nothing. A line holds for one content of the log, by its fingerprint: a log that was recorded anew
under the same name does not inherit the old one's tags.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from recorder.errors import LogError

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
            tag = Tag(first_row, last_row, check_name(entry[action]))
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
    _append(log, {"add": tag.name, "rows": [tag.first_row, tag.last_row], "log": fingerprint})


def remove_tag(log: Path, fingerprint: str, tag: Tag) -> None:
    _append(log, {"remove": tag.name, "rows": [tag.first_row, tag.last_row], "log": fingerprint})


def check_name(name: object) -> str:
    """A tag's name. Raises ValueError if it is empty, too long, or not printable."""
    if not isinstance(name, str) or not name.strip() or len(name) > _LONGEST_NAME or not name.isprintable():
        raise ValueError(f"{name!r} is not a name for a tag: 1 to {_LONGEST_NAME} printable characters")
    return name


def _row(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**32:
        raise ValueError(f"{value!r} is not a row")
    return value


def _lines(log: Path) -> list[str]:
    path = tags_path(log)
    try:
        with path.open("rb") as stream:
            data = stream.read(_MOST_BYTES + 1)
    except FileNotFoundError:
        return []
    if len(data) > _MOST_BYTES:
        raise LogError(f"{path}: larger than {_MOST_BYTES:,} bytes, which no tags are")
    whole = data[: data.rfind(b"\n") + 1]
    return whole.decode("utf-8", "replace").splitlines()


def _append(log: Path, entry: dict[str, Any]) -> None:
    path = tags_path(log)
    line = json.dumps(entry, ensure_ascii=False).encode() + b"\n"
    with path.open("ab+") as stream:
        stream.seek(0)
        data = stream.read()
        stream.truncate(data.rfind(b"\n") + 1)  # what a crash cut off was never confirmed to anybody
        stream.write(line)
        stream.flush()
        os.fsync(stream.fileno())
