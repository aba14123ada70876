"""Tags: names for stretches of a log ("recovery", "exclude", anything), kept next to it in NAME.tags.jsonl.

The file is a journal: each line adds or removes a tag, and lines are only appended. So nothing is lost if two
people tag at once, or after a crash. A line is for one content of the log, by its fingerprint: a new recording of
the same name does not inherit tags.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple, overload

import msgspec

from common.location import Location, Url
from common.locks import lock
from common.random_access import read_bytes
from recorder import topics
from recorder.errors import LogError

if TYPE_CHECKING:  # NumPy
    from recorder.log.reader import Log
    from recorder.rows.odd_stretches import OddStretch

EXCLUDE: Final = "exclude"  # rows with this tag are never trained on
FINE: Final = "fine"  # odd rows with this tag were checked, and do not count as odd
_ENDING: Final = ".tags.jsonl"
_LONGEST_NAME: Final = 64
_MAX_ROWS: Final = 2**32
MAX_BYTES: Final = 1 << 24
_Row = Annotated[int, msgspec.Meta(ge=0, lt=_MAX_ROWS)]
_BAD_ROWS: Final = re.compile(r"driven badly: rows ([0-9]{1,9}) to ([0-9]{1,9})")


class Tag(NamedTuple):
    """A name for the rows from `first_row` to `last_row`, both included."""

    first_row: int
    last_row: int
    name: str


class _Line(msgspec.Struct):
    """A line of the journal, with either `add` or `remove`."""

    rows: tuple[_Row, _Row]
    log: str
    add: str | msgspec.UnsetType = msgspec.UNSET
    remove: str | msgspec.UnsetType = msgspec.UNSET


_LINE: Final = msgspec.json.Decoder(_Line)


@overload
def tags_path(log: Path) -> Path: ...


@overload
def tags_path(log: Url) -> Url: ...


def tags_path(log: Location) -> Location:
    return log.with_name(f"{log.name.removesuffix('.mcap')}{_ENDING}")


def read_tags(log: Location, fingerprint: str) -> list[Tag]:
    """The tags of the log with this fingerprint, sorted by rows. Raises LogError for a damaged file."""
    return sorted(tags_by_content(log)[fingerprint])


def names_used(folder: Path) -> set[str]:
    """The names of the tags of all logs in a folder, with EXCLUDE and FINE."""
    return {EXCLUDE, FINE}.union(*map(_names_in, folder.glob(f"*{_ENDING}")))


def _names_in(path: Path) -> set[str]:
    try:
        tagged = tags_by_content(path.with_name(path.name.removesuffix(_ENDING)))
    except LogError:  # reported when this log's own tags are read
        return set()
    return {tag.name for tags in tagged.values() for tag in tags}


def add_tags(log: Path, fingerprint: str, tags: Sequence[Tag]) -> None:
    """Add all tags, or none if an exception is raised.

    Raises LogError for invalid names or rows, or if the file cannot be written.
    """
    _append(log, "add", fingerprint, tags)


def remove_tags(log: Path, fingerprint: str, tags: Sequence[Tag]) -> None:
    """Remove all existing ones of these tags. Raises as `add_tags`."""
    _append(log, "remove", fingerprint, tags)


def check_name(name: object) -> str:
    """A tag's name. Raises ValueError if it is empty, too long, or not printable."""
    if not isinstance(name, str) or not name.strip() or len(name) > _LONGEST_NAME or not name.isprintable():
        raise ValueError(f"{name!r} is not a name for a tag: 1 to {_LONGEST_NAME} printable characters")
    return name


def _checked(tag: Tag) -> Tag:
    check_name(tag.name)
    if not 0 <= tag.first_row <= tag.last_row < _MAX_ROWS:
        raise ValueError(f"no rows {tag.first_row} to {tag.last_row}")
    return tag


def tags_by_content(log: Location) -> defaultdict[str, set[Tag]]:
    """The tags by fingerprint. Raises LogError for a damaged file."""
    tags: defaultdict[str, set[Tag]] = defaultdict(set)
    names = set[str]()  # checked already
    for number, line in enumerate(_lines(log), start=1):
        try:
            entry = _LINE.decode(line)
            is_added = entry.add is not msgspec.UNSET
            if is_added != (entry.remove is msgspec.UNSET):
                raise ValueError("neither added nor removed, or both")
            name = str(entry.add if is_added else entry.remove)
            if name not in names:
                names.add(check_name(name))
            if entry.rows[0] > entry.rows[1]:
                raise ValueError(entry.rows)
        except (ValueError, RecursionError):  # msgspec's errors are ValueErrors
            raise LogError(f"{tags_path(log)}: line {number} is not a tag; correct or remove it") from None
        tag = Tag(*entry.rows, name)
        if is_added:
            tags[entry.log].add(tag)
        else:
            tags[entry.log].discard(tag)
    return tags


def _lines(log: Location) -> list[str]:
    path = tags_path(log)
    try:
        data = read_bytes(_plain(path) if isinstance(path, Path) else path, MAX_BYTES + 1)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from None
    if data is None:
        return []
    return _whole_lines(_bounded(path, data)).decode("utf-8", "replace").splitlines()


def _whole_lines(journal: bytes) -> bytes:
    """A journal without the last line if a crash cut that off: it was never confirmed. Other programs may end the
    last line without a line feed."""
    end = journal.rfind(b"\n") + 1
    try:
        _LINE.decode(journal[end:])
    except (ValueError, RecursionError):
        return journal[:end]
    return journal


def _bounded(path: Location, data: bytes) -> bytes:
    if len(data) > MAX_BYTES:
        raise LogError(f"{path}: larger than {MAX_BYTES:,} bytes, too large for tags")
    return data


def _append(log: Path, action: str, fingerprint: str, tags: Sequence[Tag]) -> None:
    path = tags_path(log)
    try:
        entries = [
            {action: tag.name, "rows": [tag.first_row, tag.last_row], "log": fingerprint}
            for tag in map(_checked, tags)
        ]
    except ValueError as error:
        raise LogError(f"{path}: {error}") from None
    lines = b"".join(json.dumps(entry, ensure_ascii=False).encode() + b"\n" for entry in entries)
    _append_lines(_plain(path), lines)


def _append_lines(path: Path, lines: bytes) -> None:
    try:
        with path.open("ab+", buffering=0) as stream:
            lock(stream)  # another process's unfinished line must not count as cut off
            stream.seek(0)
            whole = _whole_lines(_bounded(path, stream.read(MAX_BYTES + 1)))
            if whole and not whole.endswith(b"\n"):
                lines = b"\n" + lines
            stream.truncate(len(whole))
            try:
                while lines:
                    lines = lines[stream.write(lines) :]
                os.fsync(stream.fileno())
            except BaseException:
                stream.truncate(len(whole))
                if not whole:
                    with contextlib.suppress(OSError):  # Windows does not remove open files
                        path.unlink()
                raise
    except OSError as error:
        raise LogError(f"{path}: cannot be written ({error.strerror})") from None


def _plain(path: Path) -> Path:
    """Raise LogError for a link: in other people's logs, it could lead to any file of this machine."""
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise LogError(f"{path}: not a plain file; remove it")
    return path


def driven_badly(first_row: int, last_row: int) -> str:
    """The event of rows that a person marks as bad during a recording. They are tagged when the log is finished or
    recovered: until then, its content changes."""
    return f"driven badly: rows {first_row} to {last_row}"


def bad_rows_in(event: str) -> Tag | None:
    """The tag of rows that were `driven_badly`; None for the text of another event."""
    matched = _BAD_ROWS.fullmatch(event)
    if matched is None or int(matched[1]) > int(matched[2]):
        return None
    return Tag(int(matched[1]), int(matched[2]), EXCLUDE)


class TaggedRows:
    """The rows of a log with a tag."""

    def __init__(self, tags: Iterable[Tag], name: str = FINE) -> None:
        self._first = list[int]()  # of separate stretches, in order
        self._last = list[int]()
        for first, last, _ in sorted(tag for tag in tags if tag.name == name):
            if self._last and first <= self._last[-1] + 1:
                self._last[-1] = max(self._last[-1], last)
            else:
                self._first.append(first)
                self._last.append(last)

    def cover(self, first_row: int, last_row: int) -> bool:
        """True if all rows of a stretch have the tag."""
        at = bisect_right(self._first, first_row) - 1
        return at >= 0 and last_row <= self._last[at]

    def untagged(self, odd: Iterable[OddStretch]) -> list[OddStretch]:
        return [stretch for stretch in odd if not self.cover(stretch.first_row, stretch.last_row)]


def fine_rows(path: Location) -> TaggedRows:
    """The rows of a log tagged `fine`; none if the log or its tags cannot be read."""
    from recorder.log.reader import Log  # NumPy

    with contextlib.suppress(LogError):
        tags = tags_by_content(path)
        if any(tag.name == FINE for content_tags in tags.values() for tag in content_tags):
            with Log(path) as log:  # its fingerprint
                return TaggedRows(tags[log.fingerprint])
    return TaggedRows(())


def tags_of(log: Log) -> list[Tag]:
    """The tags of a log; of an unfinished log, also those that it gets when it is recovered. Raises LogError for a
    damaged file of tags."""
    return sorted({*read_tags(log.path, log.fingerprint), *bad_rows(log)})


def bad_rows(log: Log) -> list[Tag]:
    """The tags for rows that a person marked as bad during the recording; a finished log has them in its file of
    tags."""
    if not log.problem or not log.is_ours or topics.EVENTS not in log.counts:
        return []
    with contextlib.suppress(LogError):
        return [tag for _, event in log.decoded(topics.EVENTS) if (tag := bad_rows_in(event.message))]
    return []
