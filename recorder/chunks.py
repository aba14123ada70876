"""The physical side of an MCAP file: where its chunks lie, and what is in one, its CRC checked.

A finished file tells at its end where its chunks are. A file without a readable end (its recording was killed,
goes on still, or the file is damaged) is walked through from its start, past stretches that make no sense, and
every chunk is found whose CRC holds. The file is untrusted: no length is believed before it is compared with
the file's size. Record layouts: https://mcap.dev/spec; all integers are little-endian.
"""

from __future__ import annotations

import io
import itertools
import os
import re
import struct
import sys
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.records import Attachment, AttachmentIndex, Channel, ChunkIndex, MetadataIndex, Schema, Statistics
from mcap.records import Metadata as MetadataRecord
from mcap.stream_reader import StreamReader

from recorder.errors import LogError

MAGIC: Final = b"\x89MCAP0\r\n"
RECORD: Final = struct.Struct("<BQ")  # opcode, length of the content
_MESSAGE: Final = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
CHUNK_HEADER: Final = struct.Struct("<BQQQQI")  # opcode, length, start time, end time, uncompressed bytes, CRC
_FOOTER: Final = struct.Struct("<BQQQI")  # opcode, length, summary start, summary offset start, CRC
_FOOTER_OP, _SCHEMA, _CHANNEL, OP_MESSAGE, OP_CHUNK = 2, 3, 4, 5, 6
_MESSAGE_INDEX, _ATTACHMENT, _METADATA, _DATA_END = 7, 9, 12, 15

MAX_CHUNK_BYTES: Final = 1 << 28
"""What a chunk may unpack to; writers use 0.25 to 4 MB, and a damaged length must not take all memory."""
MAX_RECORD_BYTES: Final = MAX_CHUNK_BYTES + (1 << 20)
"""What is read at once: the largest chunk, with its header."""

# A chunk of less than 16 MiB: opcode, length, times, uncompressed size, CRC, compression.
_CHUNK_START: Final = re.compile(
    rb"\x06.{3}\x00{5}.{16}.{3}\x00{5}.{4}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4)", re.DOTALL
)
_SEARCH_BYTES: Final = 1 << 16
_MOST_WASTE: Final = 16  # times the file's size that a search may read or unpack in vain
_LEAST_BUDGET: Final = 1 << 24

# What mcap's parsers raise on bytes that are no record.
_UNREADABLE: Final = (McapError, ValueError, EOFError, KeyError, OverflowError, struct.error)


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk as it lies in the file, from `start` to `end`; or a message outside of chunks, taken as one."""

    start: int
    end: int
    compression: str = ""
    is_message: bool = False


class StoredMessage(NamedTuple):
    """A message within a chunk's records: it begins at `start`, its content is `length` bytes from `offset`."""

    channel: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    start: int
    offset: int
    length: int


@dataclass
class Structure:
    """What a file holds, and where."""

    chunks: list[Chunk] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata_at: list[int] = field(default_factory=list)  # offsets of the records
    attachments_at: list[int] = field(default_factory=list)
    statistics: Statistics | None = None  # of a finished file
    problem: str = ""  # why the file had to be walked through; empty for a finished one
    lost: list[tuple[int, int]] = field(default_factory=list)  # stretches of bytes that make no sense


class McapFile:
    """A file open for reading at any place, from any thread."""

    def __init__(self, path: Path) -> None:
        """Raises LogError if it cannot be opened or is of another kind."""
        self.path = path
        try:
            self._stream = path.open("rb")
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else "no such name"
            raise LogError(f"{path}: cannot be opened ({reason}); `bc-record NAME` makes a log") from None
        self._lock = threading.Lock()
        self.size = os.fstat(self._stream.fileno()).st_size
        if self.size < len(MAGIC) or self.read(0, len(MAGIC)) != MAGIC:
            self.close()
            raise LogError(f"{path}: not an MCAP log (it does not start with MCAP's magic bytes)")

    def close(self) -> None:
        self._stream.close()

    def read(self, offset: int, length: int) -> bytes:
        """Raises LogError for what lies outside the file, is too long for any record, or is not readable."""
        if offset < 0 or length < 0 or offset + length > self.size:
            raise self.damaged(f"bytes {offset} to {offset + length} lie outside the file")
        if length > MAX_RECORD_BYTES:
            raise self.damaged(f"a record of {length} bytes")
        try:
            if sys.platform == "win32":  # no pread there
                with self._lock:
                    self._stream.seek(offset)
                    data = self._stream.read(length)
            else:
                data = os.pread(self._stream.fileno(), length, offset)
        except OSError as error:  # a failing disk
            raise self.damaged(f"bytes {offset} to {offset + length} cannot be read ({error.strerror})") from None
        if len(data) != length:
            raise self.damaged("it has become shorter while it was read")
        return data

    def records(self, chunk: Chunk) -> bytes:
        """The records of a chunk, unpacked. Raises LogError where it is damaged, as far as its CRC can tell."""
        record = self.read(chunk.start, chunk.end - chunk.start)
        return record if chunk.is_message else self.unpacked(record, chunk.start)

    def unpacked(self, record: bytes, start: int) -> bytes:
        """The records within a chunk's `record`, which begins at byte `start`. Raises what `records` does."""
        where = f"the chunk at byte {start}"
        try:
            opcode, length, _, _, size, crc = CHUNK_HEADER.unpack_from(record)
            named = _prefixed(record, CHUNK_HEADER.size)
            stored_at = CHUNK_HEADER.size + 4 + len(named) + 8
            (stored_size,) = struct.unpack_from("<Q", record, stored_at - 8)
        except struct.error:
            raise self.damaged(f"{where} is cut off") from None
        if opcode != OP_CHUNK or RECORD.size + length != len(record) or stored_at + stored_size != len(record):
            raise self.damaged(f"{where} is not of the length it tells")
        if size > MAX_CHUNK_BYTES:
            raise self.damaged(f"{where} would unpack to {size} bytes")
        stored = memoryview(record)[stored_at:]
        try:
            records = _unpacked(stored, named, size)
        except (zstandard.ZstdError, RuntimeError, ValueError):
            raise self.damaged(f"{where} cannot be unpacked") from None
        if len(records) != size:
            raise self.damaged(f"{where} does not unpack to the {size} bytes it tells")
        if crc and zlib.crc32(records) != crc:
            raise self.damaged(f"{where} has another content than its CRC tells")
        return records

    def records_at(self, chunk: Chunk) -> int:
        """Where in the file the records of an uncompressed chunk begin."""
        return chunk.start if chunk.is_message else chunk.start + CHUNK_HEADER.size + 12

    def messages(self, records: bytes) -> Iterator[StoredMessage]:
        """The messages in a chunk's records, in their order."""
        for opcode, start, end in self._inside(records):
            if opcode == OP_MESSAGE:
                if end - start < _MESSAGE.size:
                    raise self.damaged("a message is cut off")
                _, _, channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(records, start)
                content = start + _MESSAGE.size
                yield StoredMessage(channel, sequence, log_time, publish_time, start, content, end - content)

    def definitions(self, records: bytes, structure: Structure) -> None:
        """Add the schemas and channels that are among `records`."""
        for opcode, start, end in self._inside(records):
            if opcode in (_SCHEMA, _CHANNEL):
                self._define(opcode, records[start + RECORD.size : end], structure)

    def metadata(self, offset: int) -> MetadataRecord:
        """The metadata record that begins at `offset`."""
        content = self._content(offset, _METADATA)
        try:
            record: MetadataRecord = MetadataRecord.read(ReadDataStream(io.BytesIO(content)))
        except _UNREADABLE:
            raise self.damaged("a metadata record cannot be read") from None
        return record

    def attachment(self, offset: int) -> Attachment:
        """The attachment that begins at `offset`."""
        content = self._content(offset, _ATTACHMENT)
        if content[-4:] not in (bytes(4), struct.pack("<I", zlib.crc32(content[:-4]))):
            raise self.damaged("an attachment has another content than its CRC tells")
        try:
            attachment: Attachment = Attachment.read(ReadDataStream(io.BytesIO(content)))
        except _UNREADABLE:
            raise self.damaged("an attachment cannot be read") from None
        return attachment

    def structure(self) -> Structure:
        """What is in the file: from its end if that is sound, else by walking through it."""
        found = self._summary()
        return self._walk() if found is None else found

    def is_finished(self) -> bool:
        """Whether the file has the summary at its end that tells where everything is."""
        return self._summary() is not None

    def walk_on(self, position: int, found: Structure) -> tuple[int, bool]:
        """Take into `found` what has been completed behind `position` of a file that grows.

        Where to go on next time, and whether there is nothing more to come. Start at `len(MAGIC)`, and know the
        file's new size after it. Raises LogError where the file was deleted before its end was written, or is
        damaged all over.
        """
        status = os.fstat(self._stream.fileno())
        self.size = status.st_size
        wasted, most_waste = 0, _MOST_WASTE * self.size + _LEAST_BUDGET
        while self.size - position >= RECORD.size:
            opcode, length = RECORD.unpack(self.read(position, RECORD.size))
            end = position + RECORD.size + length
            if opcode == _DATA_END and length == 4:
                return position, True
            if end > self.size and length <= MAX_CHUNK_BYTES:
                break  # it is being written
            try:
                if end > self.size:
                    raise self.damaged("no record")
                self._take(opcode, position, end, found)
            except LogError:
                wasted += min(end, self.size) - position
                if wasted > most_waste:
                    raise
                end = self._next_chunk(position + 1)
                if end == self.size:
                    break  # the next chunk may still come
                found.lost.append((position, end))
            position = end
        if status.st_nlink == 0:
            raise LogError(f"{self.path}: deleted before it was finished; nothing more will come")
        return position, False

    def _summary(self) -> Structure | None:
        tail = _FOOTER.size + len(MAGIC)
        if self.size < 2 * len(MAGIC) + _FOOTER.size:
            return None
        footer = self.read(self.size - tail, tail)
        opcode, length, start, _, crc = _FOOTER.unpack_from(footer)
        is_footer = opcode == _FOOTER_OP and length == _FOOTER.size - RECORD.size and footer.endswith(MAGIC)
        if not is_footer or not 0 < start <= self.size - tail or self.size - start > MAX_RECORD_BYTES:
            return None
        summary = self.read(start, self.size - start)
        if crc and zlib.crc32(summary[: len(summary) - len(MAGIC) - 4]) != crc:
            return None
        found = Structure()
        try:
            for record in StreamReader(
                io.BytesIO(summary),
                skip_magic=True,
                emit_chunks=True,  # it would unpack one, to whatever size
                record_size_limit=len(summary),
            ).records:
                match record:
                    case Schema():
                        found.schemas[record.id] = record
                    case Channel():
                        found.channels[record.id] = record
                    case ChunkIndex():
                        end = record.chunk_start_offset + record.chunk_length
                        found.chunks.append(Chunk(record.chunk_start_offset, end, record.compression))
                    case MetadataIndex():
                        found.metadata_at.append(record.offset)
                    case AttachmentIndex():
                        found.attachments_at.append(record.offset)
                    case Statistics():
                        found.statistics = record
        except _UNREADABLE:
            return None
        if found.statistics is None or (found.statistics.message_count and not found.chunks):
            return None  # without chunks, or without an index of them
        found.chunks.sort(key=lambda chunk: chunk.start)
        edges = [len(MAGIC), *(edge for chunk in found.chunks for edge in (chunk.start, chunk.end)), start]
        if any(later < earlier for earlier, later in itertools.pairwise(edges)):
            return None
        return found

    def _walk(self) -> Structure:
        found = Structure(problem="unfinished (its recording was killed, or is still going on)")
        position, wasted, most_waste = len(MAGIC), 0, _MOST_WASTE * self.size + _LEAST_BUDGET
        unsure = position  # from here on no CRC has held: a damaged length may have led past whole chunks
        while self.size - position >= RECORD.size:
            opcode, length = RECORD.unpack(self.read(position, RECORD.size))
            end = position + RECORD.size + length
            try:
                if end > self.size:
                    raise self.damaged("no record")
                if opcode == _DATA_END and length == 4:
                    found.problem = "its end is damaged, or has no index of chunks"
                    break
                self._take(opcode, position, end, found)
            except LogError:
                following = self._next_chunk(unsure + 1) if wasted < most_waste else self.size
                if following == position:
                    following = self._next_chunk(position + 1)
                wasted += following - unsure + _SEARCH_BYTES + self._cost(position, end)
                lost_from = position if following > position else unsure
                if found.lost and found.lost[-1][1] == lost_from:
                    found.lost[-1] = (found.lost[-1][0], following)
                else:
                    found.lost.append((lost_from, following))
                position = unsure = following
            else:
                position = end
                if opcode in (OP_CHUNK, OP_MESSAGE):
                    unsure = end
        if position < self.size and not found.problem.startswith("its end"):
            found.lost.append((position, self.size))  # a few bytes of a record that was being written
        return found

    def _take(self, opcode: int, start: int, end: int, found: Structure) -> None:
        if opcode == OP_CHUNK:
            self.definitions(self.records(Chunk(start, end)), found)
            compression = _prefixed(self.read(start, CHUNK_HEADER.size + 8), CHUNK_HEADER.size)
            found.chunks.append(Chunk(start, end, compression.decode()))
        elif opcode == OP_MESSAGE and self._is_message(start, end, found):
            found.chunks.append(Chunk(start, end, is_message=True))
        elif opcode in (_SCHEMA, _CHANNEL):
            self._define(opcode, self.read(start + RECORD.size, end - start - RECORD.size), found, exactly=True)
        elif opcode == _METADATA:
            self.metadata(start)
            found.metadata_at.append(start)
        elif opcode == _ATTACHMENT:
            self.attachment(start)
            found.attachments_at.append(start)
        elif not (opcode == _MESSAGE_INDEX and self._is_index(start, end)) and start != len(MAGIC):
            raise self.damaged("no record of a data section")  # but the header, which is the first

    def _is_message(self, start: int, end: int, found: Structure) -> bool:
        """Files without chunks exist; no file has both, and a damaged chunk may look like a message."""
        if end - start < _MESSAGE.size or (found.chunks and not found.chunks[0].is_message):
            return False
        return _MESSAGE.unpack(self.read(start, _MESSAGE.size))[2] in found.channels

    def _cost(self, start: int, end: int) -> int:
        """Bytes that were read, and at most unpacked, to find out that a record is damaged."""
        if end > self.size:
            return 0
        told = self.read(start, min(CHUNK_HEADER.size, end - start))
        size = CHUNK_HEADER.unpack(told)[4] if told[0] == OP_CHUNK and len(told) == CHUNK_HEADER.size else 0
        return end - start + (size if size <= MAX_CHUNK_BYTES else 0)

    def _is_index(self, start: int, end: int) -> bool:
        """A chunk whose first byte is damaged may look like its index too."""
        length = end - start - RECORD.size
        return length >= 6 and struct.unpack("<I", self.read(start + RECORD.size + 2, 4))[0] == length - 6

    def _next_chunk(self, position: int) -> int:
        """Where the next bytes are that look like a chunk; the file's size if nowhere."""
        while position < self.size:
            block = self.read(position, min(_SEARCH_BYTES + 64, self.size - position))
            if (match := _CHUNK_START.search(block)) is not None:
                return position + match.start()
            position += _SEARCH_BYTES
        return self.size

    def _define(self, opcode: int, content: bytes, structure: Structure, *, exactly: bool = False) -> None:
        """Outside of chunks no CRC tells a schema from other bytes, but that it is written `exactly` as it was."""
        try:
            record: Schema | Channel = (Schema if opcode == _SCHEMA else Channel).read(
                ReadDataStream(io.BytesIO(content))
            )
        except _UNREADABLE:
            raise self.damaged("a schema or channel cannot be read") from None
        if exactly and _written(record) != RECORD.pack(opcode, len(content)) + content:
            raise self.damaged("no schema or channel")
        if isinstance(record, Schema):
            structure.schemas.setdefault(record.id, record)
        else:
            structure.channels.setdefault(record.id, record)

    def _content(self, offset: int, opcode: int) -> bytes:
        found, length = RECORD.unpack(self.read(offset, RECORD.size))
        if found != opcode:
            raise self.damaged("a record is not where the summary says")
        return self.read(offset + RECORD.size, length)

    def _inside(self, records: bytes) -> Iterator[tuple[int, int, int]]:
        """Opcode, start and end of each record."""
        position, size = 0, len(records)
        while position < size:
            if size - position < RECORD.size:
                raise self.damaged("a record in a chunk is cut off")
            opcode, length = RECORD.unpack_from(records, position)
            end = position + RECORD.size + length
            if end > size:
                raise self.damaged("a record points out of its chunk")
            yield opcode, position, end
            position = end

    def damaged(self, what: str) -> LogError:
        return LogError(f"{self.path}: damaged: {what}; `bc-log recover {self.path}` saves the rest")


def _written(record: Schema | Channel) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    return written


def _prefixed(data: bytes, at: int) -> bytes:
    """A string of MCAP: its length, then its bytes; no longer than what is there."""
    (length,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + length]


def _unpacked(stored: memoryview, compression: bytes, size: int) -> bytes:
    """At most one byte more than `size`."""
    match compression:
        case b"":
            return bytes(stored)
        case b"zstd":
            with zstandard.ZstdDecompressor().stream_reader(stored) as reader:
                return bytes(reader.read(size + 1))
        case b"lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=size + 1))
    raise ValueError(f"unknown compression {compression!r}")
