"""A log that is being written, read by complete chunks as it grows."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from google.protobuf.message import DecodeError
from mcap.records import Channel

from common import Skipped
from common.closeable import Closeable
from common.files import final_path
from common.locks import is_being_written
from recorder.errors import LogError
from recorder.mcap.mcap_file import MAGIC, Chunk, McapFile, StoredMessage
from recorder.mcap.message_index import LAST_TIME_NS
from recorder.mcap.scan import Structure, read_summary, walk_on
from recorder.topics import PICTURE_TOPICS
from viz.live.live_messages import SHOWN, LiveMessage

LATE: Final = "pictures not shown, to keep up (the log has them)"
QUIET_S: Final = 2.0
"""A log that has no writer, as far as the file system shows, and has not grown for so long was killed."""


def find_log(path: Path) -> Path:
    """The present path of a log that was or will be at `path`: it has another name until its writer closes it."""
    final = final_path(path)
    for place in (path, final):
        if place.exists():
            return place
    try:
        parts = [part for part in path.parent.iterdir() if final_path(part) == path and not part.is_symlink()]
        return max(parts, key=lambda part: part.stat().st_mtime_ns, default=path)
    except OSError:  # no such folder, or it has just been given its final name
        return final if final.exists() else path


def is_finished(path: Path) -> bool:
    """True if there is a finished log at `path`. Raises LogError if it cannot be opened or is no log."""
    if not _has_begun(path):
        return False
    with McapFile(path) as file:
        return read_summary(file) is not None


class GrowingLog(Closeable):
    """The messages of a log that can be shown, as far as it has come. Its file may be renamed meanwhile.

    When nothing more will come, either `is_finished` is true, or `notice` is that the recording was killed.
    Raises LogError if it cannot be opened, is no log, is deleted before it is finished, or nothing was written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.skipped = Skipped()
        self.is_finished = False
        self.notice = ""
        self._quiet_since_s = time.monotonic()
        self._file: McapFile | None = None
        self._position = len(MAGIC)
        self._structure = Structure()

    @property
    def has_crcs(self) -> bool:
        """True if all that was read of it has CRCs, without which damage is not noticed."""
        return self._file is None or self._file.have_crcs(self._structure.chunks)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()

    def read(self, pictures_of_last_s: float | None = None) -> Iterator[list[LiveMessage]]:
        """Yield the messages completed since the last call, a list for each chunk.

        With `pictures_of_last_s`, pictures that are older than that before the newest message are skipped.
        """
        path = find_log(self.path)
        is_written = is_being_written(path)  # asked first: what was written until it died is then read
        before = self._position, len(self._structure.chunks), len(self._structure.lost)
        self._file = self._file or self._opened()
        if self._file is not None:
            self._walk_on(self._file)
        if is_written or self._position > before[0]:
            self._quiet_since_s = time.monotonic()
        elif not self.is_finished and time.monotonic() - self._quiet_since_s >= QUIET_S:
            self._end_without_end(path)
        if self._file is None:
            return
        for start, end in self._structure.lost[before[2] :]:
            self.skipped.add("stretches of unreadable bytes", f"{start:,} to {end:,}")
        chunks = self._structure.chunks[before[1] :]
        since_ns = 0
        if pictures_of_last_s is not None and chunks:
            since_ns = _newest_ns(self._file, chunks[-1]) - round(pictures_of_last_s * 1e9)
        for chunk in chunks:
            yield list(self._shown_of(self._file, chunk, since_ns))

    def _walk_on(self, file: McapFile) -> None:
        try:
            self._position, self.is_finished = walk_on(file, self._position, self._structure)
        except LogError:
            if find_log(self.path).exists():
                raise
            why = "nothing more to show: it was deleted, or its recording ended and kept nothing"
            raise LogError(f"{final_path(self.path)}: {why}") from None

    def _end_without_end(self, path: Path) -> None:
        if self._file is None:
            raise LogError(f"{path}: its recording was killed before anything of it was written")
        state = "its recording was killed; everything complete is shown"
        self.notice = f"{path}: {state}; `bc-log recover {shlex.quote(str(path))}` makes a log of it"
        if self._position < self._file.size:
            self._structure.lost.append((self._position, self._file.size))

    def _opened(self) -> McapFile | None:
        path = find_log(self.path)
        if not _has_begun(path):
            return None
        try:
            return McapFile(path)
        except LogError:
            if find_log(self.path) != path:
                return None  # it was just given its final name
            raise

    def _shown_of(self, file: McapFile, chunk: Chunk, since_ns: int) -> Iterator[LiveMessage]:
        records = file.records(chunk)
        try:
            messages = list(file.messages(records))
        except LogError:
            self.skipped.add("damaged chunks", f"bytes {chunk.start:,} to {chunk.end:,}")
            return
        for stored in messages:
            channel = self._structure.channels.get(stored.channel)
            if channel is None:
                self.skipped.add("messages whose description is lost", f"channel {stored.channel}")
            elif self._can_be_shown(channel):
                shown = self._shown(stored, channel, records, since_ns)
                if shown is not None:
                    yield shown

    def _can_be_shown(self, channel: Channel) -> bool:
        kind = SHOWN.get(channel.topic)
        return kind is not None and self._structure.is_protobuf(channel.id, kind.DESCRIPTOR.full_name)

    def _shown(self, stored: StoredMessage, channel: Channel, records: bytes, since_ns: int) -> LiveMessage | None:
        name = f"{channel.topic} row {stored.sequence}"
        if channel.topic in PICTURE_TOPICS and stored.log_time_ns < since_ns:
            self.skipped.add(LATE, name)
            return None
        try:
            content = SHOWN[channel.topic].FromString(records[stored.offset : stored.offset + stored.length])
        except DecodeError:
            self.skipped.add("messages that cannot be decoded", name)
            return None
        if stored.log_time_ns > LAST_TIME_NS:
            self.skipped.add("messages of a time that cannot be", name)
            return None
        return LiveMessage(channel.topic, stored.sequence, stored.log_time_ns, content)


def _newest_ns(file: McapFile, chunk: Chunk) -> int:
    try:
        return max((stored.log_time_ns for stored in file.messages(file.records(chunk))), default=0)
    except LogError:
        return 0  # what is damaged is counted where it is read


def _has_begun(path: Path) -> bool:
    """A log that has just been created is empty until its first chunk is written."""
    try:
        return not path.is_file() or path.stat().st_size >= len(MAGIC)
    except OSError:
        return True  # opening it raises the reason
