"""Making a finished log out of one that is unfinished or damaged."""

from __future__ import annotations

import bisect
import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from common import Skipped
from common.errors import counted
from common.files import final_path
from common.locks import is_being_written
from common.progress import track
from recorder.errors import LogError
from recorder.log import topics
from recorder.log.check_structure import is_damaged_beside_chunks
from recorder.log.derived_log import (
    LAST_ROW,
    Written,
    close_with_tags,
    copy_rest,
    new_log,
    refuse_taken,
    tags_of_rows,
)
from recorder.log.mcap_file import Chunk
from recorder.log.reader import Log
from recorder.log.tags import Tag, read_tags
from recorder.log.topics import CAMERA_TOPICS, ROW_TOPICS


def recovered_name(path: Path) -> Path:
    """The default path of a recovered log: what was being written gets the name it would have had,
    unless its recording still goes on, and will take that name itself."""
    meant = final_path(path)
    if meant != path and not meant.exists() and not is_being_written(path):
        return meant
    return meant.with_name(f"{meant.name.removesuffix('.mcap')}.recovered.mcap")


def recover(path: Path, to: Path, *, overwrite: bool = False) -> Written:
    """Write all that is whole in the log at `path`, finished or not, to the new log `to`.

    A chunk is taken if its CRC holds, wherever it lies. In a log of ours, chunks come in the order of their rows,
    and what belongs to a row that was never finished, or of which the rest is lost, is left out, and so is a
    chunk that is there again. All that is left out is in `skipped`, what may be wrong in `notices`.

    Raises LogError if nothing is whole, or if `to` is the name that the recording will take, which still goes on.
    """
    skipped = Skipped()
    refuse_taken(to, [path], overwrite)  # before a long log is read
    goes_on = is_being_written(path)
    if goes_on and to == final_path(path):
        raise LogError(f"{to}: the name that the recording will take, which still goes on; give another by --to")
    with Log(path, salvages=True) as log:
        order = _in_order_of_rows(log, skipped)
        records = _sound_metadata(log, skipped)
        session = dict(records).get(topics.SESSION_METADATA, {})
        tags = _sound_tags(log, skipped)
        count, left_out, rows = 0, 0, list[int]()
        with new_log(to, session, {"recovered_from": path.name}, overwrite) as writer:
            for chunk in track(order.chunks, f"recovering {path.name}", len(order.chunks)):
                try:
                    for schema, channel, message in log.messages_of(chunk, skipped):
                        if channel.topic in ROW_TOPICS and (why := order.why_not(message.sequence)):
                            left_out += 1
                            skipped.add(why, f"{channel.topic} row {message.sequence}")
                            continue
                        writer.copy(schema, channel, message, message.sequence)
                        count += 1
                        if channel.topic == topics.VEHICLE:
                            rows.append(message.sequence)
                except LogError:
                    skipped.add("damaged chunks", f"bytes {chunk.start:,} to {chunk.end:,}")
            if not count:
                raise LogError(f"{path}: not one whole message in it: there is nothing to recover")
            copy_rest(log, records, writer, skipped)
            close_with_tags(writer, tags_of_rows(tags, rows))
    for start, end in log.lost:
        if log.problem:
            skipped.add("stretches of bytes without anything whole", f"{start:,} to {end:,}")
        else:
            skipped.add("damaged chunks", f"bytes {start:,} to {end:,}")
    notices = []
    lost = (log.message_count or 0) - count - left_out
    if lost > 0:
        notices.append(f"{path}: lost in all: {lost:,} of {counted(log.message_count or 0, 'message')}")
    if not len(skipped) and is_damaged_beside_chunks(path):
        notices.append(
            f"{path}: metadata, or what describes topics, may be wrong: the CRC of all data does not hold,"
            " and every chunk is whole"
        )
    if goes_on:
        notices.append(f"{path}: its recording still goes on, and its end is not in {to.name}")
    return Written(to, count, len(rows), skipped, notices)


@dataclass(frozen=True)
class _Order:
    """A log's chunks in the order in which they were written, wherever they lie now."""

    chunks: list[Chunk]
    last_row: int = LAST_ROW
    torn: frozenset[int] = frozenset()  # rows of which a part is lost beside what is kept

    def why_not(self, row: int) -> str:
        """The reason why the rest of a row is left out; empty if it is taken."""
        if row > self.last_row:
            return "messages of a row that was never finished"
        return "messages of a row of which the rest is lost" if row in self.torn else ""


def _in_order_of_rows(log: Log, skipped: Skipped) -> _Order:
    """The chunks by their rows, unless several claim the same ones. Another program's log stays as it is."""
    chunks, rows = _once(log, skipped) if log.is_ours else (log.chunks, [])
    driven = [row for its_rows in rows for topic, row in its_rows if topic == topics.VEHICLE]
    if not driven:
        return _Order(chunks)
    spans = [(min(numbers), max(numbers)) for numbers in ([row for _, row in its] for its in rows) if numbers]
    firsts, first = [], -1
    for its_rows in rows:
        first = min((row for _, row in its_rows), default=first)  # without any, it stays behind the one before
        firsts.append(first)
    order = sorted(range(len(firsts)), key=firsts.__getitem__)
    is_clear = all(earlier[1] <= later[0] for earlier, later in itertools.pairwise(sorted(spans)))
    if not is_clear:
        order = list(range(len(rows)))
    holes = _holes(order, chunks, log.lost)
    torn = _torn_rows(holes, [rows[at] for at in order], is_clear=is_clear)
    return _Order([chunks[at] for at in order], max(driven), torn)


def _once(log: Log, skipped: Skipped) -> tuple[list[Chunk], list[list[tuple[str, int]]]]:
    """The chunks and the rows in them. A chunk that is there again, byte for byte, is left out: no row comes
    twice, but the same events may, in logs that were merged."""
    chunks, rows, known = [], [], dict[bytes, Chunk]()
    for chunk in log.chunks:
        its_rows, digest = _rows_in(log, chunk)
        first = known.setdefault(digest, chunk)
        if its_rows and first is not chunk:
            where = f"bytes {chunk.start:,} to {chunk.end:,}, as at {first.start:,}"
            skipped.add("repetitions of a chunk", where)
            continue
        chunks.append(chunk)
        rows.append(its_rows)
    return chunks, rows


def _holes(order: list[int], chunks: Sequence[Chunk], lost: Sequence[tuple[int, int]]) -> set[int]:
    """Before which chunks of the order something is missing; its length stands for the end."""
    if order != sorted(order):  # chunks have moved, and nobody knows from where
        return set(range(len(order) + 1)) if lost else set()
    ends = [chunk.end for chunk in chunks]
    return {bisect.bisect_right(ends, start) for start, _ in lost}


def _torn_rows(holes: set[int], rows: Sequence[list[tuple[str, int]]], *, is_clear: bool) -> frozenset[int]:
    """The rows at the edges of what is lost that lack their vehicle state, or a picture; `rows` are by chunk."""
    edges = set[int]()
    for hole in holes:
        before = next(([row for _, row in its] for its in reversed(rows[:hole]) if its), [])
        after = next(([row for _, row in its] for its in rows[hole:] if its), [])
        if is_clear:
            before, after = before and [max(before)], after and [min(after)]
        edges.update(before, after)
    parts: dict[int, set[str]] = {}
    for topic, row in itertools.chain.from_iterable(rows):
        parts.setdefault(row, set()).add(topic)
    cameras = CAMERA_TOPICS.intersection(set().union(*parts.values()))
    return frozenset(row for row in edges if not cameras | {topics.VEHICLE} <= parts[row])


def _rows_in(log: Log, chunk: Chunk) -> tuple[list[tuple[str, int]], bytes]:
    """Topic and number of every message that belongs to a row, and a digest of all messages."""
    rows, digest = [], hashlib.sha256()
    try:
        for _, channel, message in log.messages_of(chunk, Skipped()):
            if channel.topic in ROW_TOPICS:
                rows.append((channel.topic, message.sequence))
            key = (message.channel_id, message.sequence, message.log_time, message.publish_time, len(message.data))
            digest.update(repr(key).encode())
            digest.update(message.data)
    except LogError:
        return [], b""
    return rows, digest.digest()


def _sound_metadata(log: Log, skipped: Skipped) -> list[tuple[str, dict[str, str]]]:
    records = []
    for offset in log.metadata_records:
        try:
            records.append(log.metadata_record(offset))
        except LogError:
            skipped.add("damaged metadata records", f"at byte {offset:,}")
    return records


def _sound_tags(log: Log, skipped: Skipped) -> list[Tag]:
    try:
        return read_tags(log.path, log.fingerprint)
    except LogError as error:
        skipped.add("damaged files of tags", str(error))
        return []
