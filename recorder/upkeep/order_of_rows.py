"""The order of a damaged log's chunks, by the rows in them, and what was lost of which rows.

In a log of ours, pictures and everything else have chunks of their own: the two kinds are put in order each by
itself, because the rows of one small chunk are those of many chunks of pictures. Where a small chunk is lost, its
rows are, with their pictures; where a chunk of pictures is lost, its rows stay. In logs of earlier versions the
kinds are mixed: there only the rows at the edges of what is lost lack a part.
"""

from __future__ import annotations

import bisect
import hashlib
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from common import Skipped
from common.stretches import consecutive
from recorder import topics
from recorder.errors import LogError
from recorder.log.reader import Log
from recorder.mcap.compressed_image import is_image_channel
from recorder.mcap.mcap_file import Chunk
from recorder.topics import CAMERA_TOPICS, PICTURE_TOPICS, ROW_TOPICS
from recorder.upkeep.check_contents import rows_named

MISSING: Final = "stretches of rows that are missing"
_NO_ROW: Final = 2**32  # numbers have 32 bits


@dataclass(frozen=True)
class Order:
    """A log's chunks in the order in which they were written, wherever they lie now."""

    chunks: list[Chunk]
    last_row: int = _NO_ROW
    torn: frozenset[int] = frozenset()  # rows of which a part is lost beside what is kept

    def why_not(self, row: int) -> str:
        """The reason why the rest of a row is left out; empty if it is taken."""
        if row > self.last_row:
            return "messages of a row that was never finished"
        return "messages of a row of which the rest is lost" if row in self.torn else ""


class _Part(NamedTuple):
    """A chunk, and what of rows is in it."""

    chunk: Chunk
    rows: list[tuple[str, int]]  # topic and number of every message that belongs to a row
    has_pictures: bool = False
    has_others: bool = False
    first: int = -1  # of the rows
    last: int = -1


class _Kind(NamedTuple):
    """The chunks of one kind, put in order."""

    parts: list[_Part]
    is_clear: bool  # no two of them claim the same rows
    has_moved: bool


class _Gap(NamedTuple):
    """A place in the order at which something is lost: the rows before and after it."""

    before: int  # -1 at the beginning
    after: int  # _NO_ROW at the end


def in_order_of_rows(log: Log, skipped: Skipped) -> Order:
    """The chunks by their rows, unless several claim the same ones; which rows lack a part is added to `skipped`.
    Another program's log stays as it is."""
    parts = _once(log, skipped) if log.is_ours else []
    driven = {row for part in parts for topic, row in part.rows if topic == topics.VEHICLE}
    if not driven:
        if not log.problem and log.counts.get(topics.VEHICLE):  # all vehicle states are lost
            for first, last in consecutive(sorted({row for part in parts for _, row in part.rows})):
                skipped.add(MISSING, rows_named(first, last))
        return Order([part.chunk for part in parts] if log.is_ours else log.chunks)
    if any(part.has_pictures and part.has_others for part in parts):
        kind = _sorted(parts)
        return Order([part.chunk for part in kind.parts], max(driven), _torn_at_edges(kind, log.lost))
    pictures = _sorted([part for part in parts if part.has_pictures])
    others = _sorted([part for part in parts if not part.has_pictures])
    rows = sorted(driven)
    without = sorted({row for part in parts for _, row in part.rows} - driven)
    torn, last_row = set[int](), rows[-1]
    for gap in _gaps(others, log.lost):
        if gap.after == _NO_ROW:
            if log.problem:
                continue  # what follows was never finished
            last_row = _NO_ROW
        its = _between(without, gap)
        torn.update(its)
        for first, last in _missing(gap, _between(rows, gap), its):
            skipped.add(MISSING, rows_named(first, last))
    _name_missing_pictures(pictures, log.lost, driven, skipped)
    in_order = _merged(pictures, others) if pictures.has_moved or others.has_moved else parts
    return Order([part.chunk for part in in_order], last_row, frozenset(torn))


def _once(log: Log, skipped: Skipped) -> list[_Part]:
    """The chunks and the rows in them. A chunk that is there again, byte for byte, is left out: no row comes
    twice, but the same events may, in logs that were merged."""
    parts, known = [], dict[bytes, Chunk]()
    for chunk in log.chunks:
        part, digest = _read(log, chunk)
        first = known.setdefault(digest, chunk)
        if part.rows and first is not chunk:
            where = f"bytes {chunk.start:,} to {chunk.end:,}, as at {first.start:,}"
            skipped.add("repetitions of a chunk", where)
            continue
        parts.append(part)
    return parts


def _read(log: Log, chunk: Chunk) -> tuple[_Part, bytes]:
    """A chunk's rows, and a digest of all messages."""
    rows, digest, are_pictures = [], hashlib.sha256(), set[bool]()
    try:
        for schema, channel, message in log.messages_of(chunk, Skipped()):
            are_pictures.add(is_image_channel(schema, channel))
            if channel.topic in ROW_TOPICS:
                rows.append((channel.topic, message.sequence))
            key = (message.channel_id, message.sequence, message.log_time, message.publish_time, len(message.data))
            digest.update(repr(key).encode())
            digest.update(message.data)
    except LogError:
        return _Part(chunk, []), b""
    numbers = [row for _, row in rows]
    part = _Part(
        chunk,
        rows,
        has_pictures=True in are_pictures,
        has_others=False in are_pictures,
        first=min(numbers, default=-1),
        last=max(numbers, default=-1),
    )
    return part, digest.digest()


def _sorted(parts: list[_Part]) -> _Kind:
    """Chunks by their first rows, or as they lie if these are not clear; one without rows stays where it was."""
    spans = sorted((part.first, part.last) for part in parts if part.rows)
    is_clear = all(earlier[1] <= later[0] for earlier, later in itertools.pairwise(spans))
    if not is_clear:
        return _Kind(parts, is_clear=False, has_moved=False)
    firsts, first = [], -1
    for part in parts:
        first = part.first if part.rows else first
        firsts.append(first)
    order = sorted(range(len(parts)), key=firsts.__getitem__)
    return _Kind([parts[at] for at in order], is_clear=True, has_moved=order != sorted(order))


def _merged(pictures: _Kind, others: _Kind) -> Iterator[_Part]:
    """Both kinds: before each small chunk the pictures of its rows, as they were written."""
    following = list(pictures.parts)[::-1]
    last = -1
    for part in others.parts:
        last = max(last, part.last)
        while following and following[-1].first <= last:
            yield following.pop()
        yield part
    yield from reversed(following)


def _holes(kind: _Kind, parts: Sequence[_Part], lost: Sequence[tuple[int, int]]) -> set[int]:
    """Before which of `parts`, in their order, something is missing; their number stands for the end."""
    if kind.has_moved:  # nobody knows from where
        return set(range(len(parts) + 1)) if lost else set()
    ends = [part.chunk.end for part in parts]
    return {bisect.bisect_right(ends, start) for start, _ in lost}


def _gaps(kind: _Kind, lost: Sequence[tuple[int, int]]) -> Iterator[_Gap]:
    """The places where chunks of this kind may be lost, with the rows that they may have held."""
    parts = [part for part in kind.parts if part.rows]
    for hole in sorted(_holes(kind, parts, lost)):
        before, after = -1, _NO_ROW
        if hole:
            before = parts[hole - 1].last if kind.is_clear else parts[hole - 1].first
        if hole < len(parts):
            after = parts[hole].first if kind.is_clear else parts[hole].last
        yield _Gap(before, after)


def _missing(gap: _Gap, rows: list[int], torn: list[int]) -> Iterator[tuple[int, int]]:
    """Stretches of the numbers in a gap that none of its `rows` has. What was there before the first row, or after
    the last one, is known only as far as it is `torn`."""
    following = gap.before if gap.before >= 0 else min(torn, default=_NO_ROW)
    last = gap.after if gap.after < _NO_ROW else max(torn, default=-1)
    for row in rows:
        if following < row:
            yield following, row - 1
        following = row + 1
    if following <= last:
        yield following, last


def _name_missing_pictures(
    pictures: _Kind, lost: Sequence[tuple[int, int]], driven: set[int], skipped: Skipped
) -> None:
    """Add to `skipped` the rows that have no picture where chunks of pictures may be lost."""
    held: dict[str, set[int]] = {}
    for part in pictures.parts:
        for topic, row in part.rows:
            held.setdefault(topic, set()).add(row)
    gaps = list(_gaps(pictures, lost))
    for topic in sorted(held.keys() & PICTURE_TOPICS):
        without = sorted(driven - held[topic])
        its = {row for gap in gaps for row in _between(without, gap)}
        for first, last in consecutive(sorted(its)):
            skipped.add("stretches of rows without a picture", f"{topic} {rows_named(first, last)}")


def _between(rows: list[int], gap: _Gap) -> list[int]:
    return rows[bisect.bisect_left(rows, gap.before) : bisect.bisect_right(rows, gap.after)]


def _torn_at_edges(kind: _Kind, lost: Sequence[tuple[int, int]]) -> frozenset[int]:
    """The rows at the edges of lost mixed chunks that lack their vehicle state, or a picture."""
    parts = kind.parts
    edges = set[int]()
    for hole in _holes(kind, parts, lost):
        before = next(([row for _, row in part.rows] for part in reversed(parts[:hole]) if part.rows), [])
        after = next(([row for _, row in part.rows] for part in parts[hole:] if part.rows), [])
        if kind.is_clear:
            before, after = before and [max(before)], after and [min(after)]
        edges.update(before, after)
    held: dict[int, set[str]] = {}
    for topic, row in itertools.chain.from_iterable(part.rows for part in parts):
        held.setdefault(row, set()).add(topic)
    cameras = CAMERA_TOPICS.intersection(set().union(*held.values()))
    return frozenset(row for row in edges if not cameras | {topics.VEHICLE} <= held[row])
