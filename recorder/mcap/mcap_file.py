"""The bytes of an MCAP file: its records at any offset, and the content of chunks, with their CRCs checked.

The file is untrusted: every length is first compared with the file's size. Record layouts: https://mcap.dev/spec.
All integers are little-endian.
"""

from __future__ import annotations

import contextlib
import io
import shlex
import struct
import zlib
from array import array
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, McapRecord
from mcap.records import Metadata as MetadataRecord

from common.closeable import Closeable
from common.errors import NoSuchObjectError, counted, did_you_mean
from common.location import Location
from common.random_access import LocalFile, open_for_reading
from recorder.errors import LogError, recovery
from recorder.topics import LIBRARY, PROFILE

Record = TypeVar("Record", bound=McapRecord)

MAGIC: Final = b"\x89MCAP0\r\n"
RECORD: Final = struct.Struct("<BQ")  # opcode, length of the content
MESSAGE: Final = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
CHUNK_HEADER: Final = struct.Struct("<BQQQQI")  # opcode, length, start time, end time, uncompressed bytes, CRC
RECORDS_AT: Final = CHUNK_HEADER.size + 12
"""Offset of the records in an uncompressed chunk, after the lengths of its compression's name and of the
records."""
OP_MESSAGE: Final = int(Opcode.MESSAGE)  # compared for each message: a plain number is quicker
MIN_MESSAGE: Final = MESSAGE.size - RECORD.size  # content of a message without data
_DEFINITIONS: Final = frozenset((int(Opcode.SCHEMA), int(Opcode.CHANNEL)))
_LONGEST_HEADER: Final = 1 << 12
_MAX_DEFINITIONS: Final = 1 << 17  # a chunk's schemas and channels: the format has 16-bit numbers for each

MAX_CHUNK_BYTES: Final = 1 << 28
"""The largest unpacked chunk. Writers use 0.25 to 4 MB; a damaged length must not take all memory."""
MAX_RECORD_BYTES: Final = MAX_CHUNK_BYTES + (1 << 20)
"""The longest read: the largest chunk with its header."""
MIN_MESSAGE_BYTES: Final = 4
"""The least bytes of a file for each message. Compressed by zstd, the smallest regular messages take five;
messages made to fill the memory take hardly any."""
FREE_MESSAGES: Final = 1 << 16  # allowed in addition, in any file

WITHOUT_CRCS: Final = "written without CRCs: damage to it cannot be noticed"
"""The notice for another program's log without CRCs."""
_MAX_BESIDE_CHUNKS: Final = 16
"""The most bytes of attachments and metadata, in multiples of a file's size: a false summary may let them
overlap."""
NOT_UNPACKED: Final = (zstandard.ZstdError, RuntimeError, ValueError)  # the exceptions of `unpack`
# Exceptions of mcap's parsers if bytes are not a record.
UNREADABLE: Final = (McapError, ValueError, EOFError, KeyError, OverflowError, struct.error)


def unpack(stored: bytes | memoryview, compression: bytes, size: int) -> bytes:
    """The unpacked bytes, at most one more than `size`. Raises NOT_UNPACKED."""
    match compression:
        case b"":
            return bytes(stored)
        case b"zstd":
            with zstandard.ZstdDecompressor().stream_reader(stored) as reader:
                return bytes(reader.read(size + 1))
        case b"lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=size + 1))
    raise ValueError(f"unknown compression {compression!r}")


class Chunk(NamedTuple):
    """A chunk in the file, from byte `start` to `end`; or a message outside chunks, handled as a chunk."""

    start: int
    end: int
    compression: str = ""
    is_message: bool = False
    channels: frozenset[int] | None = None  # of its messages, from the summary; None: unknown
    head: bytes = b""  # its header without the CRC, from the summary


class StoredMessage(NamedTuple):
    """A message in a chunk's records. It begins at `start`; its content is `length` bytes from `offset`."""

    channel: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    start: int
    offset: int
    length: int


class Parts(NamedTuple):
    messages: array[int]  # where each begins
    definitions: list[tuple[int, int, int]]  # opcode, start and end of schemas and channels


class McapFile(Closeable):
    """A file open for reading at any offset, from any thread."""

    def __init__(self, path: Location) -> None:
        """Raises LogError if the file cannot be opened or is not an MCAP file; StoreError."""
        self.path = path
        try:
            self._bytes = open_for_reading(path)
        except NoSuchObjectError as error:
            raise LogError(str(error)) from None
        except OSError as error:
            advice = _advice(path) if isinstance(path, Path) else "; give the command again"
            raise LogError(f"{path}: cannot be opened ({error.strerror}){advice}") from None
        self._copy: Path | None = None
        self._beside_chunks_at = set[int]()  # attachments and metadata that count in `_beside_chunks_bytes`
        self._beside_chunks_bytes = 0
        self.size = 0
        self.grow()
        if self.size < len(MAGIC) or self.read(0, len(MAGIC)) != MAGIC:
            self.close()
            raise LogError(
                f"{path}: not an MCAP log (it does not start with MCAP's magic bytes); `bc-log ls` lists logs"
            )

    def close(self) -> None:
        self._bytes.close()

    @property
    def is_remote(self) -> bool:
        """True if each read is a request to a store."""
        return self._bytes.is_remote

    def read_from(self, copy: Path) -> None:
        """Read from a complete copy of this file from now on. If it is damaged, it is removed. Raises OSError."""
        opened = LocalFile(copy)
        self._bytes.close()
        self._bytes, self._copy = opened, copy

    def grow(self) -> bool:
        """Update the size of a growing file; False if the file was deleted."""
        exists = self._bytes.grow()
        self.size = self._bytes.size
        return exists

    def read(self, offset: int, length: int) -> bytes:
        """Raises LogError for a range outside the file or longer than any record, or if reading fails."""
        self._check_range(offset, length)
        try:
            data = self._bytes.read(offset, length)
        except OSError as error:  # a failing disk
            where = f"bytes {offset:,} to {offset + length:,}"
            raise self.damaged(f"{where} cannot be read ({error.strerror})") from None
        if len(data) != length:
            raise self.damaged("it has become shorter while it was read")
        return data

    def read_chunks(self, chunks: Sequence[Chunk]) -> Iterator[tuple[Chunk, bytes]]:
        """Each chunk with its unpacked records; several requests at a time for a file in a store. Raises as
        `records`."""
        ranges = ((chunk.start, chunk.end - chunk.start) for chunk in chunks)
        for chunk, data in zip(chunks, self.read_many(ranges), strict=True):
            yield chunk, self.records_in(chunk, data)

    def read_many(self, ranges: Iterable[tuple[int, int]]) -> Iterator[bytes]:
        """The bytes of each range, and no others; several requests at a time for a file in a store. Raises as
        `read`."""
        if not self.is_remote:
            yield from (self.read(offset, length) for offset, length in ranges)
            return

        def checked() -> Iterator[tuple[int, int]]:
            for offset, length in ranges:
                self._check_range(offset, length)
                yield offset, length

        yield from self._bytes.read_many(checked())

    def _check_range(self, offset: int, length: int) -> None:
        if offset < 0 or length < 0 or offset + length > self.size:
            raise self.damaged(f"bytes {offset:,} to {offset + length:,} lie outside the file")
        if length > MAX_RECORD_BYTES:
            raise self.damaged(f"a record of {length:,} bytes")

    @cached_property
    def profile_and_library(self) -> tuple[bytes, bytes]:
        """The fields of the file's first record: the profile of its content, and the program that wrote it. Empty
        if damaged."""
        try:
            opcode, length = RECORD.unpack(self.read(len(MAGIC), RECORD.size))
            header = self.read(len(MAGIC) + RECORD.size, min(length, _LONGEST_HEADER))
            profile = prefixed(header, 0)
            library = prefixed(header, 4 + len(profile))
        except (LogError, struct.error):
            return b"", b""
        return (profile, library) if opcode == Opcode.HEADER else (b"", b"")

    @property
    def is_ours(self) -> bool:
        """True if its content follows docs/log-format.md."""
        return self.profile_and_library[0] == PROFILE.encode()

    @property
    def promises_crcs(self) -> bool:
        """True if a CRC of 0, in MCAP "no CRC", is damage. This toolkit writes CRCs in all its files, also in
        copies of other programs' logs."""
        return self.is_ours or self.profile_and_library[1].startswith(LIBRARY.encode())

    def may_have_crc(self, crc: int, content: bytes) -> bool:
        """True if the CRC matches `content`, or the file has none."""
        return zlib.crc32(content) == crc or (crc == 0 and not self.promises_crcs)

    def have_crcs(self, chunks: Iterable[Chunk]) -> bool:
        return self.promises_crcs or all(
            has_crc_in(chunk, self.read(chunk.start, min(CHUNK_HEADER.size, chunk.end - chunk.start)))
            for chunk in chunks
        )

    def records(self, chunk: Chunk) -> bytes:
        """The unpacked records of a chunk. Raises LogError if the chunk is damaged."""
        return self.records_in(chunk, self.read(chunk.start, chunk.end - chunk.start))

    def records_in(self, chunk: Chunk, record: bytes) -> bytes:
        """`records` of a chunk whose bytes, `record`, were read before."""
        return record if chunk.is_message else self.unpacked(record, chunk.start)

    def unpacked(self, record: bytes, start: int) -> bytes:
        """The records in a chunk's `record`, which begins at byte `start`. Raises as `records`."""
        where = f"the chunk at byte {start:,}"
        try:
            opcode, length, _, _, size, crc = CHUNK_HEADER.unpack_from(record)
            compression = prefixed(record, CHUNK_HEADER.size)
            stored_at = CHUNK_HEADER.size + 4 + len(compression) + 8
            (stored_size,) = struct.unpack_from("<Q", record, stored_at - 8)
        except struct.error:
            raise self.damaged(f"{where} is cut off") from None
        added = len(record) - stored_at - stored_size  # by a later version of MCAP; no chunk fits in
        is_whole = 0 <= added < (1 if self.promises_crcs else RECORDS_AT)
        if opcode != Opcode.CHUNK or RECORD.size + length != len(record) or not is_whole:
            raise self.damaged(f"{where} does not have its declared length")
        if size > MAX_CHUNK_BYTES:
            raise self.damaged(f"{where} would unpack to {size:,} bytes")
        stored = memoryview(record)[stored_at : stored_at + stored_size]
        try:
            records = unpack(stored, compression, size)
        except NOT_UNPACKED:
            raise self.damaged(f"{where} cannot be unpacked") from None
        if len(records) != size:
            raise self.damaged(f"{where} does not unpack to the {size:,} bytes that it declares")
        if not self.may_have_crc(crc, records):
            raise self.damaged(f"{where} does not match its CRC")
        return records

    def records_at(self, chunk: Chunk) -> int:
        """The offset in the file of an uncompressed chunk's records."""
        return chunk.start if chunk.is_message else chunk.start + RECORDS_AT

    def messages(self, records: bytes) -> Iterator[StoredMessage]:
        """The messages in a chunk's records, in order. Raises LogError at once if a record is damaged."""
        return (stored_message(records, start) for start in self.parts(records).messages)

    def metadata(self, offset: int) -> MetadataRecord:
        return self.parsed(MetadataRecord, self._content(offset, Opcode.METADATA), "a metadata record")

    def attachment(self, offset: int) -> Attachment:
        stream = io.BytesIO(self._content(offset, Opcode.ATTACHMENT))
        attachment = self._parsed(Attachment, stream, "an attachment")
        content = stream.getvalue()[: stream.tell()]  # a later version of MCAP may add fields
        if not self.may_have_crc(int.from_bytes(content[-4:], "little"), content[:-4]):
            raise self.damaged("an attachment does not match its CRC")
        return attachment

    def parsed(self, kind: type[Record], content: bytes, name: str) -> Record:
        """The record with this content. Raises LogError for other bytes."""
        return self._parsed(kind, io.BytesIO(content), name)

    def _parsed(self, kind: type[Record], content: io.BytesIO, name: str) -> Record:
        """`parsed`; `content` is then at the end of what was read."""
        try:
            record: Record = kind.read(ReadDataStream(content))  # type: ignore[attr-defined]
        except UNREADABLE:
            raise self.damaged(f"{name} cannot be read") from None
        return record

    def _content(self, offset: int, opcode: int) -> bytes:
        stored_opcode, length = RECORD.unpack(self.read(offset, RECORD.size))
        if stored_opcode != opcode:
            raise self.damaged("a record is not where the summary says")
        if offset not in self._beside_chunks_at:
            self._beside_chunks_at.add(offset)
            self._beside_chunks_bytes += min(length, self.size)
        if self._beside_chunks_bytes > _MAX_BESIDE_CHUNKS * self.size:
            raise self.damaged(f"attachments and metadata of more than {_MAX_BESIDE_CHUNKS} times its size")
        return self.read(offset + RECORD.size, length)

    def parts(self, records: bytes) -> Parts:
        """The messages and definitions among a chunk's records. Raises LogError if one is damaged."""
        parts = Parts(array("q"), [])
        unpack, add_message = RECORD.unpack_from, parts.messages.append
        position, size = 0, len(records)
        for _ in range(self._most_messages):
            if position > size - RECORD.size:
                break
            opcode, length = unpack(records, position)
            end = position + RECORD.size + length
            if opcode == OP_MESSAGE:
                if length < MIN_MESSAGE:
                    raise self.damaged("a message is cut off")
                add_message(position)
            elif opcode in _DEFINITIONS:
                if len(parts.definitions) == _MAX_DEFINITIONS:
                    raise self.damaged("more schemas and channels than a file can have")
                parts.definitions.append((opcode, position, end))
            position = end
        else:
            raise self._too_many(f"{self._most_messages:,} records and more")
        if position > size:
            raise self.damaged("a record points out of its chunk")
        if position < size:
            raise self.damaged("a record in a chunk is cut off")
        return parts

    def check_count(self, messages: int) -> None:
        """Raise LogError if a file of this size cannot hold so many messages."""
        if messages > self._most_messages:
            raise self._too_many(counted(messages, "message"))

    @property
    def _most_messages(self) -> int:
        return self.size // MIN_MESSAGE_BYTES + FREE_MESSAGES

    def _too_many(self, count: str) -> LogError:
        return self.damaged(f"{count} in {self.size:,} bytes, which hold {self._most_messages:,} at most")

    def damaged(self, problem: str) -> LogError:
        path = self.path
        if self._copy is not None:  # then the next command fetches it anew
            with contextlib.suppress(OSError):
                self._copy.unlink(missing_ok=True)
        if not isinstance(path, Path):
            copy = f"`bc-log copy {shlex.quote(str(path))} FOLDER`"
            return LogError(f"{path}: damaged: {problem}; {copy} brings it here, for `bc-log recover`")
        return LogError(f"{path}: damaged: {problem}; {recovery(path)} saves the rest")


def has_crc_in(chunk: Chunk, head: bytes) -> bool:
    """True if a chunk has a CRC. `head`: the first bytes of its record."""
    crc_at = CHUNK_HEADER.size - 4
    return not chunk.is_message and len(head) >= CHUNK_HEADER.size and any(head[crc_at : CHUNK_HEADER.size])


def stored_message(records: bytes, start: int) -> StoredMessage:
    """The message whose record begins at `start` of a chunk's records."""
    _, length, channel, sequence, log_time, publish_time = MESSAGE.unpack_from(records, start)
    content = start + MESSAGE.size
    return StoredMessage(channel, sequence, log_time, publish_time, start, content, length - MIN_MESSAGE)


def _advice(path: Path) -> str:
    """The end of an error: a hint at the file that was meant, perhaps by the name of a session."""
    if path.is_dir():
        return f"; `bc-log ls {shlex.quote(str(path))}` lists the logs in it"
    if path.exists():
        return ""  # it may not be read
    if path.is_symlink():
        return "; it is a link to a file that is not there"
    for log in (path.with_name(f"{path.name}.mcap"), Path("sessions") / f"{path.name}.mcap"):
        if log.is_file():
            return f"; did you mean {log}?"
    parts = sorted(path.parent.glob("*.part")) if path.parent.is_dir() else []
    for part in parts:
        if part.name.startswith(f"{path.name}."):
            return f"; did you mean {part}?"
    names = [log.stem for folder in ("sessions", "drives") for log in Path(folder).glob("*.mcap")]
    return f"; {did_you_mean(path.name, names) or '`bc-record NAME` makes a log'}"


def prefixed(data: bytes, at: int) -> bytes:
    """An MCAP string: its length, then its bytes. Shorter if `data` ends before."""
    (length,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + length]
