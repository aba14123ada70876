"""Read a growing log by complete chunks, and turn its messages into the entities and curves of playback."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import rerun as rr
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError
from google.protobuf.message import Message as ProtobufMessage
from mcap.records import Channel

from common import Skipped
from common.closeable import Closeable
from common.files import final_path
from common.locks import is_being_written
from recorder.errors import LogError
from recorder.mcap.mcap_file import MAGIC, Chunk, McapFile, StoredMessage
from recorder.mcap.message_index import LAST_TIME_NS
from recorder.mcap.scan import Structure, read_summary, walk_on
from recorder.topics import EVENTS, PICTURE_TOPICS, TOPICS
from viz.playback.blueprint import CENTER, log_layout
from viz.playback.curves import Drawing, frame_size
from viz.playback.log_chunks import picture_columns
from viz.timelines import Times, log_clock

SHOWN: Final[Mapping[str, type[ProtobufMessage]]] = {name: topic.message.load() for name, topic in TOPICS.items()}
"""The shown topics, and the types of their messages."""


@dataclass(frozen=True)
class LiveMessage:
    """A message to show. `content` has the type of `SHOWN` for its topic."""

    topic: str
    row: int
    log_time_ns: int
    content: Any


class LiveMessageSender:
    """Sends messages to a recording. If it is watched, it gets a new layout when a new topic appears; else it gets
    one layout, from `finish`."""

    def __init__(self, recording: rr.RecordingStream, *, is_watched: bool) -> None:
        self._recording = recording
        self._is_watched = is_watched
        self._start_ns: int | None = None
        self._drawing = Drawing(recording, self._clock)
        self._topics: set[str] = set()
        self._laid_out: set[str] = set()
        self._has_size = False

    def send(self, messages: Sequence[LiveMessage]) -> None:
        if self._start_ns is None:
            self._start_ns = min((message.log_time_ns for message in messages), default=None)
        by_topic: dict[str, list[LiveMessage]] = {}
        for message in messages:
            by_topic.setdefault(message.topic, []).append(message)
        self._topics |= by_topic.keys()
        # pictures come first; their other topics come within a second
        if self._is_watched and not self._topics <= PICTURE_TOPICS:
            self._lay_out()
        for topic in sorted(by_topic, key=lambda topic: topic not in PICTURE_TOPICS):
            topic_messages = by_topic[topic]
            time_ns = np.array([message.log_time_ns for message in topic_messages], np.int64)
            contents = [message.content for message in topic_messages]
            if TOPICS[topic].is_picture:
                self._send_pictures(topic, time_ns, contents)
            else:
                self._drawing.send(topic, time_ns, contents)

    def finish(self) -> None:
        """Send the layout if it has changed, and the drawings of all messages until now: histogram and path. Call
        it at the end; if the recording is watched, also from time to time."""
        self._lay_out()
        self._drawing.finish()

    def _clock(self, time_ns: Times) -> list[rr.TimeColumn]:
        return log_clock(self._start_ns or 0)(time_ns)

    def _lay_out(self) -> None:
        new = self._topics - self._laid_out
        if new - {EVENTS} or (new and not self._laid_out):
            # A late first event must not reset the user's changes of the layout: the layout always has events.
            self._recording.send_blueprint(log_layout({*self._topics, EVENTS}, grows=True))
            self._laid_out |= new

    def _send_pictures(self, topic: str, time_ns: Times, pictures: list[CompressedImage]) -> None:
        if topic == CENTER and not self._has_size:
            self._has_size = True
            self._drawing.picture_size = frame_size(pictures[0].data) or self._drawing.picture_size
        columns = picture_columns([picture.data for picture in pictures], [picture.format for picture in pictures])
        self._recording.send_columns(topic, self._clock(time_ns), columns)


LATE: Final = "pictures not shown, to keep up (the log has them)"
QUIET_S: Final = 2.0  # a log without a writer that has not grown for this time counts as killed


def find_log(path: Path) -> Path:
    """The present path of the log `path`: a log has another name until its writer closes it."""
    final = final_path(path)
    for place in (path, final):
        if place.exists():
            return place
    try:
        parts = [part for part in path.parent.iterdir() if final_path(part) == path and not part.is_symlink()]
        return max(parts, key=lambda part: part.stat().st_mtime_ns, default=path)
    except OSError:  # the folder is missing, or the log has just got its final name
        return final if final.exists() else path


def is_finished(path: Path) -> bool:
    """True if `path` is a finished log. Raises LogError if it cannot be opened or is not a log."""
    if not _has_begun(path):
        return False
    with McapFile(path) as file:
        return read_summary(file) is not None


class GrowingLog(Closeable):
    """The showable messages of a growing log. Its file may be renamed meanwhile.

    At the end of the log, either `is_finished` is true, or `notice` says that the recording was killed. Raises
    LogError if the log cannot be opened, is not a log, is deleted before it is finished, or has no content.
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
        """True if all chunks read so far have CRCs. Without CRCs, damage is not detected."""
        return self._file is None or self._file.have_crcs(self._structure.chunks)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()

    def read(self, pictures_of_last_s: float | None = None) -> Iterator[list[LiveMessage]]:
        """Yield the new messages since the last call, one list for each complete chunk.

        With `pictures_of_last_s`, pictures that are older than the newest message by more than this are skipped.
        """
        path = find_log(self.path)
        is_written = is_being_written(path)  # before reading, to read everything that a killed writer wrote
        before = self._position, len(self._structure.chunks), len(self._structure.lost)
        self._file = self._file or self._open()
        if self._file is not None:
            self._walk_on(self._file)
        if is_written or self._position > before[0]:
            self._quiet_since_s = time.monotonic()
        elif not self.is_finished and time.monotonic() - self._quiet_since_s >= QUIET_S:
            self._end_killed(path)
        if self._file is None:
            return
        for start, end in self._structure.lost[before[2] :]:
            self.skipped.add("stretches of unreadable bytes", f"{start:,} to {end:,}")
        chunks = self._structure.chunks[before[1] :]
        since_ns = 0
        if pictures_of_last_s is not None and chunks:
            since_ns = _newest_ns(self._file, chunks[-1]) - round(pictures_of_last_s * 1e9)
        for chunk in chunks:
            yield list(self._messages_of(self._file, chunk, since_ns))

    def _walk_on(self, file: McapFile) -> None:
        try:
            self._position, self.is_finished = walk_on(file, self._position, self._structure)
        except LogError:
            if find_log(self.path).exists():
                raise
            why = "nothing more to show: the log was deleted, or its recording ended without a log"
            raise LogError(f"{final_path(self.path)}: {why}") from None

    def _end_killed(self, path: Path) -> None:
        if self._file is None:
            raise LogError(f"{path}: its recording was killed before it wrote anything")
        state = "its recording was killed; all complete chunks are shown"
        self.notice = f"{path}: {state}; `bc-log recover {shlex.quote(str(path))}` repairs it"
        if self._position < self._file.size:
            self._structure.lost.append((self._position, self._file.size))

    def _open(self) -> McapFile | None:
        path = find_log(self.path)
        if not _has_begun(path):
            return None
        try:
            return McapFile(path)
        except LogError:
            if find_log(self.path) != path:
                return None  # it has just got its final name
            raise

    def _messages_of(self, file: McapFile, chunk: Chunk, since_ns: int) -> Iterator[LiveMessage]:
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
                message = self._message(stored, channel, records, since_ns)
                if message is not None:
                    yield message

    def _can_be_shown(self, channel: Channel) -> bool:
        kind = SHOWN.get(channel.topic)
        return kind is not None and self._structure.is_protobuf(channel.id, kind.DESCRIPTOR.full_name)

    def _message(
        self, stored: StoredMessage, channel: Channel, records: bytes, since_ns: int
    ) -> LiveMessage | None:
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
            self.skipped.add("messages with an impossible time", name)
            return None
        return LiveMessage(channel.topic, stored.sequence, stored.log_time_ns, content)


def _newest_ns(file: McapFile, chunk: Chunk) -> int:
    try:
        return max((stored.log_time_ns for stored in file.messages(file.records(chunk))), default=0)
    except LogError:
        return 0  # `_messages_of` counts the damaged chunk


def _has_begun(path: Path) -> bool:
    """False for an empty file: a new log is empty until its first chunk."""
    try:
        return not path.is_file() or path.stat().st_size >= len(MAGIC)
    except OSError:
        return True  # opening the file raises the reason
