"""Rows with a tag: `fine` (somebody looked at odd rows, and nothing is wrong), or `exclude`."""

from __future__ import annotations

import contextlib
from bisect import bisect_right
from collections.abc import Iterable

from common.location import Location
from recorder import topics
from recorder.errors import LogError
from recorder.log.reader import Log
from recorder.log.tags import FINE, Tag, bad_rows_in, read_tags, tags_by_content
from recorder.rows.odd_stretches import OddStretch


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
        """The stretches with a row that lacks the tag."""
        return [stretch for stretch in odd if not self.cover(stretch.first_row, stretch.last_row)]


def fine_rows(path: Location) -> TaggedRows:
    """The rows of a log tagged `fine`; none if the log or its tags cannot be read."""
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
