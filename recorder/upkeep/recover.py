"""Makes a finished log from an unfinished or damaged one."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

from common import Skipped
from common.errors import counted
from common.files import final_path
from common.locks import is_being_written
from common.progress import track
from common.stretches import consecutive
from common.untrusted import real_path
from recorder import topics
from recorder.errors import LogError
from recorder.log.reader import Log
from recorder.log.tags import Tag, bad_rows, read_tags
from recorder.log.writer import close_with_tags
from recorder.rows.odd_stretches import rows_named
from recorder.upkeep.check_contents import MISFIT
from recorder.upkeep.derived_log import Written, copy_rest, new_log, refuse_taken, tags_of_rows

_MISSING: Final = "stretches of rows that are missing"
_NO_ROW: Final = 2**32  # numbers have 32 bits


def recovered_name(path: Path) -> Path:
    """The default place of a recovered log: the intended name of an unfinished log, unless its recording still
    continues and needs this name."""
    meant = final_path(path)
    if meant != path and not meant.is_file() and not is_being_written(path):
        return meant
    return meant.with_name(f"{meant.name.removesuffix('.mcap')}.recovered.mcap")


def recover(path: Path, to: Path, *, overwrite: bool = False) -> Written:
    """Write everything whole in the log at `path`, finished or not, to the new log `to`.

    All chunks with a matching CRC are kept, in the file's order. In a log of ours, rows that were never finished,
    or that lost their vehicle state, are left out; rows that only lost pictures stay. `skipped` has what is left
    out or missing, `notices` what may be wrong.

    Raises LogError if nothing is whole, or if the running recording needs the name `to`.
    """
    skipped = Skipped()
    refuse_taken(to, [path], overwrite)  # before a long log is read
    goes_on = is_being_written(path)
    if goes_on and real_path(to) == final_path(real_path(path)):
        raise LogError(f"{to}: the running recording will get this name; give another one with --to")
    with Log(path, salvages=True) as log:
        lost = lost_rows(log, skipped)
        records = _sound_metadata(log, skipped)
        session = dict(records).get(topics.SESSION_METADATA, {})
        tags = _sound_tags(log, skipped)
        count, left_out, rows = 0, 0, list[int]()
        with new_log(log, to, session, {"recovered_from": path.name}, overwrite) as writer:
            for chunk in track(log.chunks, f"recovering {path.name}", len(log.chunks)):
                try:
                    for schema, channel, message in log.messages_of(chunk, skipped):
                        if channel.topic in topics.ROW_TOPICS and (why := lost.why_not(message.sequence)):
                            left_out += 1
                            skipped.add(why, f"{channel.topic} row {message.sequence}")
                            continue
                        try:
                            writer.copy(schema, channel, message, message.sequence)
                        except LogError:
                            left_out += 1
                            skipped.add(MISFIT, f"{channel.topic} row {message.sequence}")
                            continue
                        count += 1
                        if channel.topic == topics.VEHICLE:
                            rows.append(message.sequence)
                except LogError:
                    skipped.add("damaged chunks", f"bytes {chunk.start:,} to {chunk.end:,}")
            if not count:
                raise LogError(f"{path}: no complete message in it: there is nothing to recover")
            copy_rest(log, records, writer, skipped)
            tags += bad_rows(log)
            close_with_tags(writer, tags_of_rows(tags, rows))
    for start, end in log.lost:
        if log.problem:
            skipped.add("stretches of unreadable bytes", f"{start:,} to {end:,}")
        else:
            skipped.add("damaged chunks", f"bytes {start:,} to {end:,}")
    notices = []
    lost_count = log.message_count - count - left_out
    if lost_count > 0:
        notices.append(f"{path}: lost in all: {lost_count:,} of {counted(log.message_count, 'message')}")
    if log.is_ours and not rows and (log.problem or len(skipped)):
        notices.append(f"{path}: no complete row in it: the new log has no rows")
    if goes_on:
        notices.append(f"{path}: it is still being recorded; {to.name} lacks its end")
    return Written(to, count, len(rows), skipped, notices)


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


@dataclass(frozen=True)
class LostRows:
    """The rows whose messages are left out, with the reason."""

    last_row: int = _NO_ROW
    torn: frozenset[int] = frozenset()  # rows that lost a part

    def why_not(self, row: int) -> str:
        """The reason why the rest of a row is left out; empty if it is kept."""
        if row > self.last_row:
            return "messages of a row that was never finished"
        return "messages of a row whose other parts are lost" if row in self.torn else ""


def lost_rows(log: Log, skipped: Skipped) -> LostRows:
    """The rows that lack a part. Adds missing rows to `skipped`. Another program's log has no rows."""
    by_topic: dict[str, set[int]] = {}
    for chunk in log.chunks if log.is_ours else ():
        with contextlib.suppress(LogError):
            for _, channel, message in log.messages_of(chunk, Skipped()):
                if channel.topic in topics.ROW_TOPICS:
                    by_topic.setdefault(channel.topic, set()).add(message.sequence)
    driven, all_rows = by_topic.get(topics.VEHICLE, set()), set().union(*by_topic.values())
    if not driven:
        if not log.problem and log.counts.get(topics.VEHICLE):  # all vehicle states are lost
            for first, last in consecutive(sorted(all_rows)):
                skipped.add(_MISSING, rows_named(first, last))
        return LostRows()
    if not log.lost:
        return LostRows(max(driven) if log.problem else _NO_ROW)
    last_row = max(driven if log.problem else all_rows)  # in a killed log, later rows were never finished
    for before, after in pairwise([min(all_rows) - 1, *sorted(driven), last_row + 1]):
        if after > before + 1:
            skipped.add(_MISSING, rows_named(before + 1, after - 1))
    for topic in sorted(topics.PICTURE_TOPICS & by_topic.keys()):
        for first, last in consecutive(sorted(driven - by_topic[topic])):
            skipped.add("stretches of rows without a picture", f"{topic} {rows_named(first, last)}")
    return LostRows(last_row, frozenset(all_rows - driven))
