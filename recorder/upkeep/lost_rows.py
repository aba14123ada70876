"""Which rows a damaged log has lost, by the rows in the chunks that are whole.

In a log of ours, pictures and everything else have chunks of their own. Where a small chunk is lost, its rows are,
with their pictures; where a chunk of pictures is lost, its rows stay. In logs of earlier versions the kinds are
mixed: there the rows at the edges of what is lost are dropped if they lack a part.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from common import Skipped
from common.stretches import consecutive
from recorder.errors import LogError
from recorder.log.reader import Log
from recorder.mcap.mcap_file import Chunk
from recorder.topics import CAMERA_TOPICS, PICTURE_TOPICS, ROW_TOPICS, VEHICLE
from recorder.upkeep.check_contents import rows_named

_MISSING: Final = "stretches of rows that are missing"
_NO_ROW: Final = 2**32  # numbers have 32 bits
_Rows = dict[str, list[int]]  # by topic, in the order of their messages


@dataclass(frozen=True)
class LostRows:
    """The rows of which messages are left out."""

    last_row: int = _NO_ROW
    torn: frozenset[int] = frozenset()  # rows of which a part is lost

    def why_not(self, row: int) -> str:
        """The reason why the rest of a row is left out; empty if it is taken."""
        if row > self.last_row:
            return "messages of a row that was never finished"
        return "messages of a row of which the rest is lost" if row in self.torn else ""


def lost_rows(log: Log, skipped: Skipped, out_of_order: Skipped) -> LostRows:
    """The rows that lack a part. Rows that are missing are added to `skipped`, chunks whose rows come too late, or
    again, to `out_of_order`. Another program's log has no rows."""
    chunks = [(chunk, _rows_in(log, chunk)) for chunk in log.chunks] if log.is_ours else []
    for reason, name in _late(chunks):
        out_of_order.add(reason, name)
    all_rows = {row for _, rows in chunks for numbers in rows.values() for row in numbers}
    driven = sorted({row for _, rows in chunks for row in rows.get(VEHICLE, ())})
    if not driven:
        if not log.problem and log.counts.get(VEHICLE):  # all vehicle states are lost
            for first, last in consecutive(sorted(all_rows)):
                skipped.add(_MISSING, rows_named(first, last))
        return LostRows()
    if any(rows.keys() & PICTURE_TOPICS and rows.keys() - PICTURE_TOPICS for _, rows in chunks):
        return LostRows(driven[-1], _torn_at_edges(chunks, log.lost))
    torn = sorted(all_rows.difference(driven)) if log.lost else []
    for before, after in _gaps(chunks, log.lost, VEHICLE):
        if after == _NO_ROW and log.problem:
            continue  # what follows was never finished
        for first, last in _missing(before, after, _between(driven, before, after), _between(torn, before, after)):
            skipped.add(_MISSING, rows_named(first, last))
    for topic in sorted(PICTURE_TOPICS.intersection(set().union(*(rows for _, rows in chunks)))):
        dark = sorted(set(driven).difference(*(rows.get(topic, ()) for _, rows in chunks)))
        gaps = _gaps(chunks, log.lost, topic)
        named = {row for before, after in gaps for row in _between(dark, before, after)}
        for first, last in consecutive(sorted(named)):
            skipped.add("stretches of rows without a picture", f"{topic} {rows_named(first, last)}")
    return LostRows(driven[-1] if log.problem else _NO_ROW, frozenset(torn))


def _rows_in(log: Log, chunk: Chunk) -> _Rows:
    rows: _Rows = {}
    try:
        for _, channel, message in log.messages_of(chunk, Skipped()):
            if channel.topic in ROW_TOPICS:
                rows.setdefault(channel.topic, []).append(message.sequence)
    except LogError:
        return {}
    return rows


def _late(chunks: Sequence[tuple[Chunk, _Rows]]) -> Iterator[tuple[str, str]]:
    """The chunks whose rows should come earlier in the file, or were there already."""
    highest = dict.fromkeys((VEHICLE, *CAMERA_TOPICS), -1)
    for chunk, rows in chunks:
        for topic in highest.keys() & rows.keys():
            if min(rows[topic]) <= highest[topic]:
                where = f"{rows_named(min(rows[topic]), max(rows[topic]))} at byte {chunk.start:,}"
                yield "chunks out of order, or there twice, which stay where they are", where
                break
        for topic in highest.keys() & rows.keys():
            highest[topic] = max(highest[topic], *rows[topic])


def _gaps(
    chunks: Sequence[tuple[Chunk, _Rows]], lost: Sequence[tuple[int, int]], topic: str
) -> Iterator[tuple[int, int]]:
    """The rows of a topic before and after each place where chunks of it may be lost: -1 at the beginning,
    `_NO_ROW` at the end."""
    held = [(chunk.end, rows[topic]) for chunk, rows in chunks if topic in rows]
    ends = [end for end, _ in held]
    for at in sorted({bisect.bisect_right(ends, start) for start, _ in lost}):
        yield max(held[at - 1][1]) if at else -1, min(held[at][1]) if at < len(held) else _NO_ROW


def _missing(before: int, after: int, rows: list[int], torn: list[int]) -> Iterator[tuple[int, int]]:
    """Stretches of the numbers in a gap that none of its `rows` has. What was there before the first row, or after
    the last one, is known only as far as it is `torn`."""
    following = before if before >= 0 else min(torn, default=_NO_ROW)
    last = after if after < _NO_ROW else max(torn, default=-1)
    for row in rows:
        if following < row:
            yield following, row - 1
        following = row + 1
    if following <= last:
        yield following, last


def _between(rows: list[int], before: int, after: int) -> list[int]:
    return rows[bisect.bisect_left(rows, before) : bisect.bisect_right(rows, after)]


def _torn_at_edges(chunks: Sequence[tuple[Chunk, _Rows]], lost: Sequence[tuple[int, int]]) -> frozenset[int]:
    """The rows at the edges of lost mixed chunks that lack their vehicle state, or a picture."""
    held: dict[int, set[str]] = {}
    for _, rows in chunks:
        for topic, numbers in rows.items():
            for row in numbers:
                held.setdefault(row, set()).add(topic)
    spans = [(chunk.end, [row for numbers in rows.values() for row in numbers]) for chunk, rows in chunks if rows]
    ends = [end for end, _ in spans]
    holes = {bisect.bisect_right(ends, start) for start, _ in lost}
    edges = {max(spans[at - 1][1]) for at in holes if at} | {min(spans[at][1]) for at in holes if at < len(spans)}
    parts = CAMERA_TOPICS.intersection(set().union(*held.values())) | {VEHICLE}
    return frozenset(row for row in edges if not parts <= held[row])
