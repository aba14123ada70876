"""Which rows a damaged log has lost, by the rows in the chunks that are whole.

A row whose vehicle state is lost is lost with its pictures; one that lost only pictures stays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
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
    by_topic: dict[str, set[int]] = {}
    for _, rows in chunks:
        for topic, numbers in rows.items():
            by_topic.setdefault(topic, set()).update(numbers)
    driven, all_rows = by_topic.get(VEHICLE, set()), set().union(*by_topic.values())
    if not driven:
        if not log.problem and log.counts.get(VEHICLE):  # all vehicle states are lost
            for first, last in consecutive(sorted(all_rows)):
                skipped.add(_MISSING, rows_named(first, last))
        return LostRows()
    if not log.lost:
        return LostRows(max(driven) if log.problem else _NO_ROW)
    last_row = max(driven if log.problem else all_rows)  # of a killed log, what follows was never finished
    for before, after in pairwise([min(all_rows) - 1, *sorted(driven), last_row + 1]):
        if after > before + 1:
            skipped.add(_MISSING, rows_named(before + 1, after - 1))
    for topic in sorted(PICTURE_TOPICS & by_topic.keys()):
        for first, last in consecutive(sorted(driven - by_topic[topic])):
            skipped.add("stretches of rows without a picture", f"{topic} {rows_named(first, last)}")
    return LostRows(last_row, frozenset(all_rows - driven))


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
