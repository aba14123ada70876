"""Reading a log: what it says of itself, its vehicle states, and where in the file each picture lies.

A log is read through the indexes that MCAP keeps at its end and behind each chunk; pictures are not touched
until somebody asks for one. The file is untrusted: every offset is checked before it is followed.
"""

from __future__ import annotations

import hashlib
import os
import struct
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

import numpy as np
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.summary import Summary
from numpy.typing import NDArray

from recorder import topics
from recorder.bc_pb2 import PilotCommand, VehicleState
from recorder.errors import LogError

# Record layouts: https://mcap.dev/spec. All integers are little-endian.
_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEADER = struct.Struct("<BQ")  # opcode, length of the content
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel id, sequence, log time, publish time
_MESSAGE_INDEX = struct.Struct("<BQHI")  # opcode, length, channel id, bytes of (log time, offset) pairs
_CHUNK = struct.Struct("<BQQQQI")  # opcode, length, start time, end time, uncompressed size, CRC
_CHUNK_FIXED_BYTES = _CHUNK.size + 4 + 8  # then an empty compression name and the size of the records
_LAST_TIME_NS = 2**63 - 1  # MCAP's times are unsigned, but those of files, tables and NumPy are not
_OP_MESSAGE, _OP_CHUNK, _OP_MESSAGE_INDEX = 0x05, 0x06, 0x07

# What mcap's reader raises on damaged bytes, a seek to before the file or far behind it among them.
_UNREADABLE = (McapError, ValueError, EOFError, KeyError, OverflowError, MemoryError, OSError, struct.error)

Decoded = TypeVar("Decoded", VehicleState, PilotCommand)

_IMAGE_DATA_FIELD = 2  # foxglove.CompressedImage.data
_LONGEST_FIELD_HEADER = 20  # two varints of at most ten bytes


@dataclass(frozen=True)
class Message:
    """One message as it lies in the file: `data` is `length` bytes from `offset`."""

    sequence: int
    log_time_ns: int
    offset: int
    length: int


@dataclass(frozen=True)
class Pictures:
    """Where the pictures of one topic lie in their log; arrays of one length, in the order of writing."""

    sequence: NDArray[np.int64]
    log_time_ns: NDArray[np.int64]
    offset: NDArray[np.int64]  # of the JPEG or PNG itself, from the start of the file
    length: NDArray[np.int64]  # bytes


class Log:
    """A finished log, open for reading. Use it as a context manager, or call `close()`.

    Raises LogError where the file is missing, not an MCAP file, unfinished, compressed or damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._stream = path.open("rb")
        except OSError as error:
            raise LogError(f"{path}: cannot be opened ({error.strerror}); `bc-record NAME` makes a log") from None
        try:
            head = self._stream.read(len(_MAGIC))
            if head != _MAGIC:
                raise LogError(f"{path}: not an MCAP log (it does not start with MCAP's magic bytes)")
            self._size = os.fstat(self._stream.fileno()).st_size
            self._lock = threading.Lock()
            self._summary = self._read_summary()
        except BaseException:
            self._stream.close()
            raise
        self._topics = {channel.id: channel.topic for channel in self._summary.channels.values()}

    def _read_summary(self) -> Summary:
        self._stream.seek(0)
        try:
            summary = make_reader(self._stream).get_summary()
        except _UNREADABLE:
            summary = None
        if summary is None or summary.statistics is None:
            raise LogError(
                f"{self.path}: the log has no readable end: its recording was killed, or is still going on"
            )
        for chunk in summary.chunk_indexes:
            if chunk.compression:
                raise LogError(
                    f"{self.path}: compressed with {chunk.compression}; logs of this toolkit are uncompressed"
                )
        return summary

    def close(self) -> None:
        self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def metadata(self) -> dict[str, str]:
        """The record `bc.session`: where the log comes from. Empty if it has none."""
        return self.read_metadata(topics.SESSION_METADATA)

    def read_metadata(self, name: str) -> dict[str, str]:
        """The last metadata record called `name`, or {}."""
        self._stream.seek(0)
        try:
            records = list(make_reader(self._stream).iter_metadata())
        except _UNREADABLE as error:
            raise self._damaged("its metadata cannot be read") from error
        found = [record.metadata for record in records if record.name == name]
        return dict(found[-1]) if found else {}

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic, from the summary."""
        assert self._summary.statistics is not None  # noqa: S101  (checked when the log was opened)
        counts = self._summary.statistics.channel_message_counts
        return {topic: counts.get(channel, 0) for channel, topic in self._topics.items()}

    @property
    def fingerprint(self) -> str:
        """Tells this content from any other: SHA-256 over the chunks' headers (with the CRC of each chunk's
        content) and the file's size. It reads some 50 bytes a chunk, and changes with any picture."""
        digest = hashlib.sha256(struct.pack("<Q", self._size))
        for chunk in self._chunks():
            digest.update(self._slice(chunk.chunk_start_offset, _CHUNK.size))
        return digest.hexdigest()

    def read(self, offset: int, length: int) -> bytes:
        """`length` bytes from `offset`, as `Pictures` gives them. May be called from several threads."""
        return self._slice(offset, length)

    def messages(self, topic: str) -> list[Message]:
        """Where the messages of `topic` lie, in the order of writing."""
        ids = {channel for channel, name in self._topics.items() if name == topic}
        found: list[Message] = []
        for chunk in self._chunks():
            start = chunk.chunk_start_offset + _CHUNK_FIXED_BYTES
            end = chunk.chunk_start_offset + chunk.chunk_length
            in_chunk = [
                self._message(start + int(offset), end, ids)
                for channel, index_offset in chunk.message_index_offsets.items()
                if channel in ids
                for offset in self._index_offsets(index_offset, channel)
            ]
            found += sorted(in_chunk, key=lambda message: message.offset)
        return found

    def pictures(self, topic: str) -> Pictures:
        """Where the pictures of a CompressedImage topic lie. No picture is read, only its message's header."""
        rows = [(m.sequence, m.log_time_ns, *self._image_range(topic, m)) for m in self.messages(topic)]
        return Pictures(*np.array(rows, dtype=np.int64).reshape(len(rows), 4).T)

    def vehicle_states(self) -> Iterator[tuple[Message, VehicleState]]:
        return self._decoded(topics.VEHICLE, VehicleState)

    def commands(self) -> Iterator[tuple[Message, PilotCommand]]:
        return self._decoded(topics.PILOT_COMMAND, PilotCommand)

    def _decoded(self, topic: str, kind: type[Decoded]) -> Iterator[tuple[Message, Decoded]]:
        for message in self.messages(topic):
            try:
                yield message, kind.FromString(self._slice(message.offset, message.length))
            except DecodeError as error:
                raise self._damaged(f"a message on {topic} is not a {kind.DESCRIPTOR.full_name}") from error

    def _chunks(self) -> list[ChunkIndex]:
        return sorted(self._summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)

    def _index_offsets(self, at: int, channel: int) -> NDArray[np.uint64]:
        opcode, _, found_channel, size = _MESSAGE_INDEX.unpack(self._slice(at, _MESSAGE_INDEX.size))
        if opcode != _OP_MESSAGE_INDEX or found_channel != channel or size % 16:
            raise self._damaged("a message index is not where the summary says")
        pairs = np.frombuffer(self._slice(at + _MESSAGE_INDEX.size, size), dtype="<u8").reshape(-1, 2)
        return pairs[:, 1]

    def _message(self, at: int, end: int, channels: set[int]) -> Message:
        if at + _MESSAGE.size > end:
            raise self._damaged("a message index points out of its chunk")
        opcode, size, channel, sequence, log_time_ns, _ = _MESSAGE.unpack(self._slice(at, _MESSAGE.size))
        length = size - (_MESSAGE.size - _RECORD_HEADER.size)
        if opcode != _OP_MESSAGE or channel not in channels or length < 0 or at + _MESSAGE.size + length > end:
            raise self._damaged("a message is not where its index says")
        if log_time_ns > _LAST_TIME_NS:
            raise self._damaged(f"a message of the time {log_time_ns} ns")
        return Message(sequence, log_time_ns, at + _MESSAGE.size, length)

    def _image_range(self, topic: str, message: Message) -> tuple[int, int]:
        """Offset and length of the field `data` of a serialised CompressedImage.

        Walks the message's fields (https://protobuf.dev/programming-guides/encoding/) and skips their
        contents, so that a picture's bytes are never read, whatever the order of the fields.
        """
        position, end = message.offset, message.offset + message.length
        while position < end:
            head = self._slice(position, min(_LONGEST_FIELD_HEADER, end - position))
            tag, size, head_length = _length_delimited(head)
            position += head_length
            if size < 0 or position + size > end:
                raise self._damaged(f"a message on {topic} is not a CompressedImage")
            if tag >> 3 == _IMAGE_DATA_FIELD:
                return position, size
            position += size
        return end, 0  # protobuf leaves an empty field out

    def _slice(self, offset: int, length: int) -> bytes:
        if offset < 0 or length < 0 or offset + length > self._size:
            raise self._damaged(f"bytes {offset} to {offset + length} lie outside the file")
        if sys.platform == "win32":  # no pread there
            with self._lock:
                self._stream.seek(offset)
                data = self._stream.read(length)
        else:
            data = os.pread(self._stream.fileno(), length, offset)
        if len(data) != length:
            raise self._damaged("it has become shorter while it was read")
        return data

    def _damaged(self, what: str) -> LogError:
        return LogError(f"{self.path}: damaged: {what}")


def _length_delimited(head: bytes) -> tuple[int, int, int]:
    """Tag, size and the length of both, of a length-delimited protobuf field; size -1 if it is none."""
    tag, position = _varint(head, 0)
    size, position = _varint(head, position)
    return (tag, size, position) if tag & 7 == 2 else (tag, -1, position)


def _varint(data: bytes, position: int) -> tuple[int, int]:
    """A base-128 varint and the position behind it; (-1, position) if it is cut off."""
    value, shift = 0, 0
    for i in range(position, len(data)):
        value |= (data[i] & 0x7F) << shift
        if data[i] < 0x80:
            return value, i + 1
        shift += 7
    return -1, len(data)
