"""New logs out of old ones: recovered, trimmed, merged, split. Nothing edits a log in place.

Messages are copied as they are. Rows keep their numbers, except in a merged log, where each one still has a number
of its own.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from mcap.records import Channel, Schema
from mcap.records import Message as McapMessage
from numpy.typing import NDArray

from common import Skipped
from common.files import refuse_existing
from common.progress import track
from recorder import topics
from recorder.errors import LogError
from recorder.log import Log
from recorder.quality import drive_numbers
from recorder.topics import CAMERAS, camera_topic
from recorder.writer import LogWriter

ROW_TOPICS: Final = frozenset(
    (
        *map(camera_topic, CAMERAS),
        topics.VEHICLE,
        topics.PILOT_INPUT,
        topics.PILOT_COMMAND,
        topics.POSE,
    )
)
"""Their messages carry their row's number as sequence number."""

_LAST_ROW: Final = 2**32 - 1  # sequence numbers of MCAP have 32 bits
_MOST_DRIVES: Final = 500  # a log of each is open at once

Copied = tuple[Schema | None, Channel, McapMessage]


@dataclass(frozen=True)
class Written:
    """A new log."""

    path: Path
    messages: int
    rows: int
    skipped: Skipped


def recovered_name(path: Path) -> Path:
    """Where a recovered log goes unless told otherwise: what was being written gets the name it would have had."""
    meant = path.with_name(re.sub(r"\.[0-9a-f]{6}\.part$", "", path.name))
    if meant != path and not meant.exists():
        return meant
    return meant.with_name(f"{meant.name.removesuffix('.mcap')}.recovered.mcap")


def recover(path: Path, to: Path, *, overwrite: bool = False) -> Written:
    """Write all that is whole in the log at `path`, finished or not, to the new log `to`.

    A chunk is taken if its CRC holds; what is left out is in `skipped`. Raises LogError if nothing is whole.
    """
    skipped = Skipped()
    _refuse(to, [path], overwrite)  # before a long log is read
    with Log(path) as log:
        expected = sum(log.counts.values()) if not log.problem else None
        records = _sound_metadata(log, skipped)
        session = next((values for name, values in reversed(records) if name == topics.SESSION_METADATA), None)
        metadata = {**session, "recovered_from": _name(path)} if session else None
        profile = topics.PROFILE if session else ""
        count = rows = 0
        with LogWriter(to, metadata, overwrite=overwrite, profile=profile) as writer:
            for chunk in track(log.chunks, f"recovering {path.name}", len(log.chunks)):
                try:
                    for schema, channel, message in log.messages_of(chunk, skipped):
                        writer.copy(schema, channel, message, message.sequence)
                        count += 1
                        rows += channel.topic == topics.VEHICLE
                except LogError:
                    skipped.add("damaged chunks", f"bytes {chunk.start:,} to {chunk.end:,}")
            if not count:
                raise LogError(f"{path}: not one whole message in it: there is nothing to recover")
            _copy_rest(log, records, writer, skipped)
    for start, end in log.lost:
        skipped.add("stretches of bytes without anything whole", f"{start:,} to {end:,}")
    if expected is not None and count < expected:
        skipped.add("messages of damaged chunks", f"{expected - count:,} of {expected:,}")
    return Written(to, count, rows, skipped)


def trim(path: Path, to: Path, rows: tuple[int, int], *, overwrite: bool = False) -> Written:
    """Write the rows from the first to the last of `rows`, both included, to the new log `to`.

    Messages without a row (events) are taken if they are of the same time. Raises LogError without such rows.
    """
    _refuse(to, [path], overwrite)
    skipped = Skipped()
    with Log(path) as log:
        number, time_ns = _rows(log)
        chosen = time_ns[(number >= rows[0]) & (number <= rows[1])]
        if not len(chosen):
            raise LogError(f"{path}: no row from {rows[0]} to {rows[1]}; {_range(number)}")
        metadata = {**log.metadata, "trimmed_from": _name(path), "rows": f"{rows[0]}-{rows[1]}"}
        first_ns, last_ns = int(chosen.min()), int(chosen.max())
        count = 0
        with LogWriter(to, metadata, overwrite=overwrite) as writer:
            for schema, channel, message in _messages(log, "trimming"):
                if channel.topic in ROW_TOPICS:
                    is_in = rows[0] <= message.sequence <= rows[1]
                else:
                    is_in = first_ns <= message.log_time <= last_ns
                if is_in:
                    writer.copy(schema, channel, message, message.sequence)
                    count += 1
            _copy_rest(log, log.all_metadata(), writer, skipped)
    return Written(to, count, len(chosen), skipped)


def merge(paths: Sequence[Path], to: Path, *, overwrite: bool = False) -> Written:
    """Write several logs into one, in the order given: the rows of each are numbered on from those before.

    Raises LogError if the numbers do not suffice.
    """
    _refuse(to, paths, overwrite)
    skipped = Skipped()
    count = rows = following = 0
    with contextlib.ExitStack() as stack:
        logs = [stack.enter_context(Log(path)) for path in paths]
        metadata = {"source": "merged", "merged_from": ", ".join(map(_name, paths))}
        writer = stack.enter_context(LogWriter(to, metadata, overwrite=overwrite))
        for log in logs:
            first = following
            for schema, channel, message in _messages(log, "merging"):
                sequence = message.sequence
                if channel.topic in ROW_TOPICS:
                    sequence += first
                    if sequence > _LAST_ROW:
                        raise LogError(f"{log.path}: row {message.sequence} would have a number above {_LAST_ROW}")
                    following = max(following, sequence + 1)
                writer.copy(schema, channel, message, sequence)
                count += 1
                rows += channel.topic == topics.VEHICLE
            writer.add_metadata(f"{topics.SESSION_METADATA} of {_name(log.path)}", log.metadata)
            _copy_rest(log, log.all_metadata(), writer, skipped)
    return Written(to, count, rows, skipped)


def split(path: Path, folder: Path, *, overwrite: bool = False) -> list[Written]:
    """Write each drive of the log at `path` to a log of its own in `folder`: NAME-1.mcap, NAME-2.mcap ...

    A new drive begins after a gap of a second, or where time goes back. Messages without a row go to the drive
    beside whose rows they lie in the file. Raises LogError if there is only one drive.
    """
    with Log(path) as log, contextlib.ExitStack() as stack:
        number, time_ns = _rows(log)
        drives = drive_numbers(time_ns)
        if not len(drives) or drives[-1] == 0:
            raise LogError(f"{path}: a single drive, nothing to split")
        if drives[-1] >= _MOST_DRIVES:
            raise LogError(f"{path}: {drives[-1] + 1:,} drives are too many files; trim the parts that you want")
        name = path.name.removesuffix(".mcap")
        targets = [folder / f"{name}-{drive + 1}.mcap" for drive in range(int(drives[-1]) + 1)]
        for target in targets:
            refuse_existing(target, overwrite)
        metadata = {**log.metadata, "split_from": _name(path)}
        writers = [
            stack.enter_context(LogWriter(target, {**metadata, "drive": str(drive)}, overwrite=overwrite))
            for drive, target in enumerate(targets)
        ]
        drive_of = dict(zip(number.tolist(), drives.tolist(), strict=True))
        counts, at = [0] * len(writers), 0
        for schema, channel, message in _messages(log, "splitting"):
            if channel.topic in ROW_TOPICS:
                at = drive_of.get(message.sequence, at)
            writers[at].copy(schema, channel, message, message.sequence)
            counts[at] += 1
        skipped = [Skipped() for _ in writers]
        for writer, left_out in zip(writers, skipped, strict=True):
            _copy_rest(log, log.all_metadata(), writer, left_out)
    rows = np.bincount(drives).tolist()
    return [Written(*parts) for parts in zip(targets, counts, rows, skipped, strict=True)]


def rows_between(log: Log, start_s: float, end_s: float) -> tuple[int, int]:
    """The first and the last row between two times, in seconds from the log's first row.

    Raises LogError if there is none, or if they are not one stretch because time goes back in this log.
    """
    number, time_ns = _rows(log)
    since_s = (time_ns - time_ns[:1]) / 1e9
    (at,) = np.nonzero((since_s >= start_s) & (since_s <= end_s))
    if not len(at):
        last = f"it lasts {since_s.max():.1f} s" if len(since_s) else "it has none at all"
        raise LogError(f"{log.path}: no row between {start_s:g} and {end_s:g} s; {last}")
    if at[-1] - at[0] + 1 != len(at):
        raise LogError(f"{log.path}: time goes back within {start_s:g} to {end_s:g} s; give --rows instead")
    return int(number[at[0]]), int(number[at[-1]])


def _rows(log: Log) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number and time of every row, in the order of the log."""
    messages = log.messages(topics.VEHICLE)
    if not messages:
        raise LogError(f"{log.path}: no rows in it ({topics.VEHICLE} is empty)")
    return (
        np.array([message.sequence for message in messages], np.int64),
        np.array([message.log_time_ns for message in messages], np.int64),
    )


def _range(number: NDArray[np.int64]) -> str:
    return f"its rows are {number.min()} to {number.max()}"


def _messages(log: Log, doing: str) -> Iterator[Copied]:
    for chunk in track(log.chunks, f"{doing} {log.path.name}", len(log.chunks)):
        yield from log.messages_of(chunk)


def _refuse(to: Path, originals: Sequence[Path], overwrite: bool) -> None:
    refuse_existing(to, overwrite)
    if to.exists() and any(path.exists() and to.samefile(path) for path in originals):
        raise LogError(f"{to}: the log itself, which stays as it is; give another name")


def _name(path: Path) -> str:
    """Its name, what is not UTF-8 in it escaped: a log's text is UTF-8."""
    return path.name.encode("utf-8", "backslashreplace").decode("utf-8")


def _sound_metadata(log: Log, skipped: Skipped) -> list[tuple[str, dict[str, str]]]:
    records = []
    for offset in log.metadata_records:
        try:
            records.append(log.metadata_record(offset))
        except LogError:
            skipped.add("damaged metadata records", f"at byte {offset:,}")
    return records


def _copy_rest(
    log: Log, metadata: Sequence[tuple[str, dict[str, str]]], writer: LogWriter, skipped: Skipped
) -> None:
    """Metadata (but what the new log says itself) and attachments."""
    for name, values in metadata:
        if name not in (topics.SESSION_METADATA, topics.QUALITY_METADATA):
            writer.add_metadata(name, values)
    for offset in log.attachments:
        try:
            writer.copy_attachment(log.attachment(offset))
        except LogError:
            skipped.add("damaged attachments", f"at byte {offset:,}")
