"""Trims, merges, splits and rewrites logs into new logs. No log is edited in place.

Messages are copied unchanged, after a check of each chunk's CRC. Metadata has no CRC of its own: only `bc-log
check` compares the CRC of the whole file. Rows keep their numbers, except in a merged log. The tags of a new log's
rows are written next to it.
"""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema
from mcap.records import Message as McapMessage
from numpy.typing import NDArray

from common import Skipped
from common.files import final_path, refuse_existing
from common.interrupts import uninterrupted
from common.progress import track
from recorder import topics
from recorder.errors import LogError, recovery
from recorder.log.reader import Log
from recorder.log.session_car import max_steering_deg_of
from recorder.log.tags import Tag, tags_of
from recorder.log.writer import LogWriter, close_with_tags, write_tags
from recorder.mcap.compressed_image import is_image_channel
from recorder.rows.row_quality import drive_numbers
from recorder.upkeep.derived_log import (
    LAST_ROW,
    Written,
    copy_rest,
    new_log,
    refuse_taken,
    tags_of_rows,
)

Copied = tuple[Schema | None, Channel, McapMessage]


def trim(path: Path, to: Path, rows: tuple[int, int], *, overwrite: bool = False) -> Written:
    """Write the rows from the first to the last of `rows`, both included, to the new log `to`.

    Messages without a row (events) are included if their times fit. Raises LogError without any row.
    """
    refuse_taken(to, [path], overwrite)
    with Log(path) as log:
        number, time_ns = _rows(log)
        is_chosen = (number >= rows[0]) & (number <= rows[1])
        if not is_chosen.any():
            raise LogError(f"{path}: no row from {rows[0]} to {rows[1]}; {_range(number)}")
        first_ns, last_ns = int(time_ns[is_chosen].min()), int(time_ns[is_chosen].max())

        def is_in(channel: Channel, message: McapMessage) -> bool:
            if channel.topic in topics.ROW_TOPICS:
                return rows[0] <= message.sequence <= rows[1]
            return first_ns <= message.log_time <= last_ns

        chosen = number[is_chosen].tolist()
        tags = tags_of_rows(tags_of(log), chosen)
        about = {"trimmed_from": path.name, "rows": f"{min(chosen)}-{max(chosen)}"}
        return _copied(log, to, is_in, tags, about, overwrite)


def trim_times(path: Path, to: Path, start_s: float, end_s: float, *, overwrite: bool = False) -> Written:
    """Write the rows between two times, both included, in seconds from the log's first row, to the new log `to`.

    In another program's log without rows, times count from its first message, and select messages by log time.
    Raises LogError if nothing is between them, or if the rows are not one stretch because time goes back.
    """
    refuse_taken(to, [path], overwrite)
    with Log(path) as log:
        if log.counts.get(topics.VEHICLE):
            return trim(path, to, rows_between(log, start_s, end_s), overwrite=overwrite)
        first_ns = log.time_range_ns[0]

        def is_in(_: Channel, message: McapMessage) -> bool:
            return start_s <= (message.log_time - first_ns) / 1e9 <= end_s

        return _copied(log, to, is_in, [], {"trimmed_from": path.name}, overwrite)


def merge(paths: Sequence[Path], to: Path, *, overwrite: bool = False) -> Written:
    """Write several logs into one, in the given order, with continuous row numbers.

    Raises LogError if the numbers do not suffice, or if the wheels' angles at steering 1 differ.
    """
    refuse_taken(to, paths, overwrite)
    skipped = Skipped()
    count = row_count = following = 0
    with contextlib.ExitStack() as stack:
        logs = [stack.enter_context(Log(path)) for path in paths]
        _refuse_different_steering(logs)
        tags = [tags_of(log) for log in logs]
        merged_tags: list[Tag] = []
        metadata = {"source": "merged", "merged_from": ", ".join(path.name for path in paths)}
        writer = stack.enter_context(LogWriter(to, metadata, overwrite=overwrite))
        for log, log_tags in zip(logs, tags, strict=True):
            first, rows = following, list[int]()
            for schema, channel, message in _messages(log, "merging"):
                sequence = message.sequence
                if channel.topic in topics.ROW_TOPICS:
                    sequence += first
                    if sequence > LAST_ROW:
                        raise LogError(f"{log.path}: row {message.sequence} would have a number above {LAST_ROW}")
                    following = max(following, sequence + 1)
                writer.copy(schema, channel, message, sequence)
                count += 1
                if channel.topic == topics.VEHICLE:
                    rows.append(message.sequence)
            row_count += len(rows)
            merged_tags += [
                Tag(tag.first_row + first, tag.last_row + first, tag.name) for tag in tags_of_rows(log_tags, rows)
            ]
            writer.add_metadata(f"{topics.SESSION_METADATA} of {log.path.name}", log.metadata)
            copy_rest(log, log.all_metadata, writer, skipped)
        close_with_tags(writer, merged_tags)
    return Written(to, count, row_count, skipped)


def _refuse_different_steering(logs: Sequence[Log]) -> None:
    first, *others = [(log.path, max_steering_deg_of(log)) for log in logs]
    for path, degrees in others:
        if degrees != first[1]:
            raise LogError(f"{path}: steering 1 is {degrees:g} degrees in it, and {first[1]:g} in {first[0]}")


def split(path: Path, folder: Path, *, overwrite: bool = False) -> list[Written]:
    """Write each drive of the log at `path` to a log of its own in `folder`: NAME-1.mcap, NAME-2.mcap ...

    A new drive begins after a gap of more than a second, or where time goes back. A picture without a row goes to
    the drive of the picture before it in the file, another message without a row to that of the vehicle state
    before it. Raises LogError if there is only one drive.
    """
    with Log(path) as log, contextlib.ExitStack() as stack:
        number, time_ns = _rows(log)
        drives = drive_numbers(time_ns)
        if not len(drives) or drives[-1] == 0:
            raise LogError(f"{path}: has a single drive: nothing to split")
        name = final_path(path).name.removesuffix(".mcap")
        targets = [folder / f"{name}-{drive + 1}.mcap" for drive in range(int(drives[-1]) + 1)]
        for target in targets:
            refuse_existing(target, overwrite)
        tags, session = tags_of(log), log.metadata
        writers = []
        for drive, target in enumerate(targets):
            about = {"split_from": path.name, "drive": str(drive)}
            writers.append(new_log(log, target, session, about, overwrite))
            stack.callback(writers[-1].discard)
        drive_of = dict(zip(number.tolist(), drives.tolist(), strict=True))
        counts = [0] * len(writers)
        last_drive = {True: 0, False: 0}  # of the last picture, and of the last other message
        for schema, channel, message in _messages(log, "splitting"):
            is_picture = is_image_channel(schema, channel)
            if channel.topic in topics.ROW_TOPICS:
                last_drive[is_picture] = drive_of.get(message.sequence, last_drive[is_picture])
            drive = last_drive[is_picture]
            writers[drive].copy(schema, channel, message, message.sequence)
            counts[drive] += 1
        skipped = [Skipped() for _ in writers]
        for writer, left_out in zip(writers, skipped, strict=True):
            copy_rest(log, log.all_metadata, writer, left_out)
            writer.finish()
        rows = [number[drives == drive].tolist() for drive in range(len(targets))]
        with uninterrupted():
            for writer, drive_rows in zip(writers, rows, strict=True):
                writer.publish()
                write_tags(writer.path, tags_of_rows(tags, drive_rows))
    return [Written(*parts) for parts in zip(targets, counts, map(len, rows), skipped, strict=True)]


def rewrite(path: Path, to: Path, *, overwrite: bool = False) -> Written:
    """Write a finished log to the new log `to` in this version's layout, with pictures in separate chunks.

    Messages, times, rows and tags stay the same, and so does the fingerprint, by which indexes and runs recognise
    it. Raises LogError for an unfinished log, or another program's.
    """
    refuse_taken(to, [path], overwrite)
    with Log(path) as log:
        if log.problem:
            raise LogError(f"{path}: {log.problem}; {recovery(path)} makes a finished log of it")
        if not log.is_ours:
            importing = f"`bc-import {shlex.quote(str(path))} NAME`"
            raise LogError(f"{path}: another program's log; import it with {importing}")
        tags, about = tags_of(log), {"rewritten_from": path.name}
        return _copied(log, to, lambda *_: True, tags, about, overwrite, same_as=log.fingerprint)


def rows_between(log: Log, start_s: float, end_s: float) -> tuple[int, int]:
    """The first and the last row between two times, in seconds from the log's first row.

    Second 0 also begins before rows of earlier times, such as a merged log's. Raises LogError if there is no row,
    or if the rows are not one stretch because time goes back.
    """
    number, time_ns = _rows(log)
    since_s = (time_ns - time_ns[:1]) / 1e9
    (at,) = np.nonzero((since_s >= (start_s or -np.inf)) & (since_s <= end_s))
    if not len(at):
        stretch = f"{start_s:g} and {end_s:g} s" if end_s < np.inf else f"{start_s:g} s and its end"
        raise LogError(f"{log.path}: no row between {stretch}; it lasts {since_s.max():.1f} s")
    if at[-1] - at[0] + 1 != len(at):
        raise LogError(f"{log.path}: time goes back within {start_s:g} to {end_s:g} s; give --rows instead")
    return int(number[at[0]]), int(number[at[-1]])


def check_rows(log: Log, rows: tuple[int, int]) -> None:
    """Raise LogError if the log lacks the first or the last of `rows`."""
    number, _ = _rows(log)
    if rows[0] < number.min() or rows[1] > number.max():
        raise LogError(f"{log.path}: not all rows from {rows[0]} to {rows[1]} are in it; {_range(number)}")


def _rows(log: Log) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number and time of every row, in the order of the log."""
    number, time_ns = log.rows_and_times()
    if not len(number):
        raise LogError(f"{log.path}: no rows in it (nothing on {topics.VEHICLE}); `bc-log trim` takes times of it")
    return number, time_ns


def _range(number: NDArray[np.int64]) -> str:
    return f"its rows are {number.min()} to {number.max()}"


def _messages(log: Log, doing: str) -> Iterator[Copied]:
    for chunk in track(log.chunks, f"{doing} {log.path.name}", len(log.chunks)):
        yield from log.messages_of(chunk)


def _copied(
    log: Log,
    to: Path,
    is_in: Callable[[Channel, McapMessage], bool],
    tags: Sequence[Tag],
    about: dict[str, str],
    overwrite: bool,
    same_as: str = "",
) -> Written:
    """Copy the messages that `is_in` accepts, and write `tags`. `same_as`: the fingerprint of a rewritten log."""
    skipped, count, row_count = Skipped(), 0, 0
    with new_log(log, to, log.metadata, about, overwrite) as writer:
        for schema, channel, message in _messages(log, "rewriting" if same_as else "trimming"):
            if is_in(channel, message):
                writer.copy(schema, channel, message, message.sequence)
                count += 1
                row_count += channel.topic == topics.VEHICLE
        if not count and not same_as:
            first_ns, last_ns = log.time_range_ns
            raise LogError(f"{log.path}: no message of these times; it lasts {(last_ns - first_ns) / 1e9:.1f} s")
        copy_rest(log, log.all_metadata, writer, skipped)
        writer.same_as = same_as
        close_with_tags(writer, tags)
    return Written(to, count, row_count, skipped)
