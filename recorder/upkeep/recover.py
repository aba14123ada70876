"""Making a finished log out of one that is unfinished or damaged."""

from __future__ import annotations

import contextlib
from pathlib import Path

from common import Skipped
from common.errors import counted
from common.files import final_path
from common.locks import is_being_written
from common.progress import track
from common.untrusted import real_path
from recorder import topics
from recorder.errors import LogError
from recorder.log.bad_rows import bad_rows_in
from recorder.log.reader import Log
from recorder.log.tags import Tag, read_tags
from recorder.topics import ROW_TOPICS
from recorder.upkeep.check_structure import is_damaged_beside_chunks
from recorder.upkeep.derived_log import (
    Written,
    close_with_tags,
    copy_rest,
    new_log,
    refuse_taken,
    tags_of_rows,
)
from recorder.upkeep.lost_rows import lost_rows


def recovered_name(path: Path) -> Path:
    """The default place of a recovered log: what was being written gets the name it would have had,
    unless its recording still goes on, and will take that name itself."""
    meant = final_path(path)
    if meant != path and not meant.is_file() and not is_being_written(path):
        return meant
    return meant.with_name(f"{meant.name.removesuffix('.mcap')}.recovered.mcap")


def recover(path: Path, to: Path, *, overwrite: bool = False) -> Written:
    """Write all that is whole in the log at `path`, finished or not, to the new log `to`.

    A chunk is taken if its CRC holds; chunks stay in the file's order. In a log of ours, a row that was never
    finished, or whose vehicle state is lost, is left out; one that lost only pictures stays. What is left out or
    missing is in `skipped`, what may be wrong in `notices`.

    Raises LogError if nothing is whole, or if `to` is the name that the recording will take, which still goes on.
    """
    skipped, out_of_order = Skipped(), Skipped()
    refuse_taken(to, [path], overwrite)  # before a long log is read
    goes_on = is_being_written(path)
    if goes_on and real_path(to) == final_path(real_path(path)):
        raise LogError(f"{to}: the running recording will get this name; give another one with --to")
    with Log(path, salvages=True) as log:
        lost = lost_rows(log, skipped, out_of_order)
        records = _sound_metadata(log, skipped)
        session = dict(records).get(topics.SESSION_METADATA, {})
        tags = _sound_tags(log, skipped)
        count, left_out, rows = 0, 0, list[int]()
        with new_log(log, to, session, {"recovered_from": path.name}, overwrite) as writer:
            for chunk in track(log.chunks, f"recovering {path.name}", len(log.chunks)):
                try:
                    for schema, channel, message in log.messages_of(chunk, skipped):
                        if channel.topic in ROW_TOPICS and (why := lost.why_not(message.sequence)):
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
                raise LogError(f"{path}: no complete message in it: there is nothing to recover")
            copy_rest(log, records, writer, skipped)
            tags += _bad_rows(log)
            close_with_tags(writer, tags_of_rows(tags, rows))
    for start, end in log.lost:
        if log.problem:
            skipped.add("stretches of bytes without anything whole", f"{start:,} to {end:,}")
        else:
            skipped.add("damaged chunks", f"bytes {start:,} to {end:,}")
    notices = [f"{path}: {line}" for line in out_of_order.lines()]
    lost_count = (log.message_count or 0) - count - left_out
    if lost_count > 0:
        notices.append(f"{path}: lost in all: {lost_count:,} of {counted(log.message_count or 0, 'message')}")
    if log.is_ours and not rows and len(skipped):
        notices.append(f"{path}: no complete row in it: the new log has no rows")
    if not len(skipped) and is_damaged_beside_chunks(path):
        notices.append(
            f"{path}: metadata or descriptions of topics may be wrong: every chunk is sound, but not the"
            " CRC of all data"
        )
    if goes_on:
        notices.append(f"{path}: it is still being recorded; {to.name} lacks its end")
    return Written(to, count, len(rows), skipped, notices)


def _bad_rows(log: Log) -> list[Tag]:
    """The rows that a person found bad while a log was recorded, whose tags come with its end."""
    if not log.problem or not log.is_ours or topics.EVENTS not in log.counts:
        return []
    with contextlib.suppress(LogError):
        return [tag for _, event in log.decoded(topics.EVENTS) if (tag := bad_rows_in(event.message))]
    return []


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
