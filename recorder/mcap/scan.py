"""The structure of an MCAP file, from the summary at its end or by walking through it.

A file has no readable end if its recording was killed or still continues, or if it is damaged. Then it is walked
through from its start. Unreadable stretches are skipped, and every chunk with a matching CRC is found.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, ChunkIndex, McapRecord, MetadataIndex, Schema, Statistics
from mcap.stream_reader import StreamReader

from common.locks import is_being_written
from recorder.errors import LogError
from recorder.mcap.compressed_image import is_image_channel, is_protobuf_channel
from recorder.mcap.mcap_file import (
    CHUNK_HEADER,
    MAGIC,
    MAX_CHUNK_BYTES,
    MAX_RECORD_BYTES,
    MESSAGE,
    RECORD,
    RECORDS_AT,
    UNREADABLE,
    Chunk,
    McapFile,
    prefixed,
)
from recorder.topics import QUALITY_METADATA

GOES_ON: Final = "unfinished: its recording is still going on"
KILLED: Final = "unfinished: its recording was killed, or it was cut off"
DAMAGED: Final = "damaged"
"""The problem of a finished log of another program that lists no chunks at its end."""

_FOOTER: Final = struct.Struct("<BQQQI")  # opcode, length, summary start, summary offset start, CRC

# A chunk below 16 MiB: opcode, length, times, uncompressed size, CRC, compression.
_CHUNK_START: Final = re.compile(
    rb"\x06.{3}\x00{5}.{16}.{3}\x00{5}.{4}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4)", re.DOTALL
)
_SEARCH_BYTES: Final = 1 << 16


@dataclass
class Structure:
    """The chunks and other records of a file, and their offsets."""

    chunks: list[Chunk] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata_at: list[int] = field(default_factory=list)  # offsets of the records
    attachments_at: list[int] = field(default_factory=list)
    statistics: Statistics | None = None  # of a finished file
    problem: str = ""  # why the file had to be walked through; empty for a finished file
    has_end: bool = True  # the data section is finished
    data_end: int = 0  # where the data section ends, by the footer; 0: unknown
    attachment_names: dict[int, str] = field(default_factory=dict)  # by offset; from the summary
    has_quality: bool = False  # from the summary; our logs with rows and a CRC of all data have it
    lost: list[tuple[int, int]] = field(default_factory=list)  # unreadable stretches of bytes

    @property
    def image_channels(self) -> set[int]:
        return {
            number
            for number, channel in self.channels.items()
            if is_image_channel(self.schemas.get(channel.schema_id), channel)
        }

    def is_protobuf(self, channel: int, schema: str) -> bool:
        """True if a channel's messages have this schema, in Protobuf."""
        record = self.channels[channel]
        return is_protobuf_channel(self.schemas.get(record.schema_id), record, schema)


def read_structure(file: McapFile) -> Structure:
    """The structure of the file, from its end or, if that is damaged, by walking through it."""
    structure = read_summary(file)
    if structure is None:
        return walk(file)
    if is_complete(structure):
        return structure
    # the summary and each of its parts are optional: the file may be finished without them
    walked = walk(file, structure.data_end)
    return replace(walked, problem="" if walked.has_end and not walked.lost else DAMAGED)


def is_complete(summary: Structure) -> bool:
    """True if a summary lists as many records as it counts."""
    statistics = summary.statistics
    return (
        statistics is not None
        and len(summary.chunks) == statistics.chunk_count
        and len(summary.channels) >= statistics.channel_count
        and len(summary.schemas) >= statistics.schema_count
        and len(summary.metadata_at) == statistics.metadata_count
        and len(summary.attachments_at) == statistics.attachment_count
        and (summary.chunks != [] or not statistics.message_count)
        and (statistics.channel_message_counts != {} or not statistics.message_count)
    )


def walk_on(file: McapFile, position: int, structure: Structure) -> tuple[int, bool]:
    """Add the records that were completed after `position` of a growing file to `structure`.

    Start at `len(MAGIC)`. Returns the position for the next call, and True if nothing more will come. Updates the
    file's size. Raises LogError if the file was deleted before its end was written.
    """
    exists = file.grow()
    while file.size - position >= RECORD.size:
        opcode, length = RECORD.unpack(file.read(position, RECORD.size))
        end = position + RECORD.size + length
        if opcode == Opcode.DATA_END and length == 4:
            return position, True
        if end > file.size and length <= MAX_CHUNK_BYTES:
            break  # this record is being written
        try:
            if end > file.size:
                raise file.damaged("no record")
            add_record(file, opcode, position, end, structure)
        except LogError:
            end = next_chunk(file, position + 1)
            if end == file.size:
                break  # the next chunk may still come
            structure.lost.append((position, end))
        position = end
    if not exists:
        raise LogError(f"{file.path}: deleted before it was finished; nothing more will come")
    return position, False


def read_summary(file: McapFile) -> Structure | None:
    """The structure from the summary at the file's end; None if the end is missing or damaged. A finished file
    without a summary has an empty one."""
    start, summary = _summary(file)
    if not summary:
        return None
    structure = Structure(data_end=start)
    try:
        for record in _records(summary):
            match record:
                case ChunkIndex():
                    structure.chunks.append(_listed(record))
                case Schema():
                    structure.schemas[record.id] = record
                case Channel():
                    structure.channels[record.id] = record
                case MetadataIndex():
                    structure.metadata_at.append(record.offset)
                    structure.has_quality |= record.name == QUALITY_METADATA
                case AttachmentIndex():
                    structure.attachments_at.append(record.offset)
                    structure.attachment_names[record.offset] = record.name
                case Statistics():
                    structure.statistics = record
    except UNREADABLE:
        return None
    structure.chunks.sort(key=lambda chunk: chunk.start)
    edges = [len(MAGIC), *(edge for chunk in structure.chunks for edge in (chunk.start, chunk.end)), start]
    if any(later < earlier for earlier, later in itertools.pairwise(edges)):
        return None
    return structure


def _listed(index: ChunkIndex) -> Chunk:
    """A chunk that a summary lists. Raises UNREADABLE."""
    start, size = index.chunk_start_offset, index.chunk_length
    times = index.message_start_time, index.message_end_time
    head = CHUNK_HEADER.pack(Opcode.CHUNK, size - RECORD.size, *times, index.uncompressed_size, 0)
    channels = frozenset(index.message_index_offsets) or None
    return Chunk(start, start + size, index.compression, channels=channels, head=head[:-4])


def counts_no_message(file: McapFile) -> bool:
    """True for a finished file whose statistics count no message."""
    with contextlib.suppress(*UNREADABLE):
        for record in _records(_summary(file)[1]):  # mostly, chunk indexes come after the statistics
            if isinstance(record, Statistics):
                return not record.message_count
    return False


def _summary(file: McapFile) -> tuple[int, bytes]:
    """The start of the summary section, and its bytes to the file's end, with the footer; empty if the end is
    missing or damaged."""
    tail = _FOOTER.size + len(MAGIC)
    if file.size < len(MAGIC) + tail:
        return 0, b""
    footer = file.read(file.size - tail, tail)
    opcode, length, start, _, crc = _FOOTER.unpack_from(footer)
    is_footer = opcode == Opcode.FOOTER and length == _FOOTER.size - RECORD.size and footer.endswith(MAGIC)
    start = start or file.size - tail  # 0: no summary, the footer follows the data section
    if not is_footer or start > file.size - tail or file.size - start > MAX_RECORD_BYTES:
        return 0, b""
    summary = file.read(start, file.size - start)
    return (start, summary) if file.may_have_crc(crc, summary[: len(summary) - len(MAGIC) - 4]) else (0, b"")


def _records(summary: bytes) -> Iterator[McapRecord]:
    """The records of a summary section. Raises UNREADABLE."""
    reader = StreamReader(
        io.BytesIO(summary),
        skip_magic=True,
        emit_chunks=True,  # otherwise it unpacks chunks to any size
        record_size_limit=len(summary),
    )
    return reader.records


def walk(file: McapFile, data_end: int = 0) -> Structure:
    """The structure from a walk from the file's start to its end; unreadable stretches are in `lost`. `data_end`:
    see `Structure`."""
    problem = GOES_ON if isinstance(file.path, Path) and is_being_written(file.path) else KILLED
    structure = Structure(problem=problem, has_end=False, data_end=data_end)
    position = len(MAGIC)
    unsure = position  # no CRC has matched after it: a damaged length may have led past whole chunks
    while file.size - position >= RECORD.size:
        opcode, length = RECORD.unpack(file.read(position, RECORD.size))
        end = position + RECORD.size + length
        try:
            if end > file.size:
                raise file.damaged("no record")
            if opcode == Opcode.DATA_END and (length == 4 or end == data_end):
                structure.problem = "its end is damaged"
                structure.has_end = True
                break
            add_record(file, opcode, position, end, structure)
        except LogError:
            following = next_chunk(file, unsure + 1)
            if following == position:
                following = next_chunk(file, position + 1)
            lost_from = position if following > position else unsure
            if structure.lost and structure.lost[-1][1] == lost_from:
                structure.lost[-1] = (structure.lost[-1][0], following)
            else:
                structure.lost.append((lost_from, following))
            position = unsure = following
        else:
            position = end
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                unsure = end
    if position < file.size and not structure.has_end:
        structure.lost.append((position, file.size))  # the beginning of a record that was being written
    return structure


def salvage(file: McapFile, structure: Structure) -> None:
    """Take the damaged chunks out of a finished file's structure, and note their places as `lost`. If others have
    moved, they are found by their CRCs. A walk through an unfinished file has done both."""
    if structure.problem:
        return
    whole = []
    for chunk in structure.chunks:
        try:
            file.parts(file.records(chunk))
        except LogError:
            structure.lost.append((chunk.start, chunk.end))
        else:
            whole.append(chunk)
    structure.chunks = whole
    if structure.lost:
        walked = walk(file, structure.data_end)
        starts = {chunk.start for chunk in whole}
        if moved := [chunk for chunk in walked.chunks if chunk.start not in starts]:
            structure.chunks = sorted([*whole, *moved], key=lambda chunk: chunk.start)
            structure.lost = walked.lost
            structure.metadata_at, structure.attachments_at = walked.metadata_at, walked.attachments_at


def add_record(file: McapFile, opcode: int, start: int, end: int, structure: Structure) -> None:
    """Add the data section's record from `start` to `end` to `structure`. Raises LogError if it is not a
    record."""
    if opcode == Opcode.CHUNK:
        add_definitions(file, file.records(Chunk(start, end)), structure)
        compression = prefixed(file.read(start, CHUNK_HEADER.size + 8), CHUNK_HEADER.size)
        structure.chunks.append(Chunk(start, end, compression.decode()))
    elif opcode == Opcode.MESSAGE and _is_message(file, start, end, structure):
        structure.chunks.append(Chunk(start, end, is_message=True))
    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        content = file.read(start + RECORD.size, end - start - RECORD.size)
        _add_definition(file, opcode, content, structure, exactly=True)
    elif opcode == Opcode.METADATA:
        file.metadata(start)
        structure.metadata_at.append(start)
    elif opcode == Opcode.ATTACHMENT:
        file.attachment(start)
        structure.attachments_at.append(start)
    elif (
        not (opcode == Opcode.MESSAGE_INDEX and _is_index(file, start, end))
        and not (opcode > Opcode.DATA_END and _is_of_unknown_kind(file, start, end))
        and start != len(MAGIC)
    ):
        raise file.damaged("no record of a data section")  # except the header, which is the first record


def _is_message(file: McapFile, start: int, end: int, structure: Structure) -> bool:
    """True for a message of a file without chunks, from another program. In files with chunks, damage may look
    like a message."""
    has_chunks = bool(structure.chunks) and not structure.chunks[0].is_message
    if file.promises_crcs or end - start < MESSAGE.size or has_chunks:
        return False
    return MESSAGE.unpack(file.read(start, MESSAGE.size))[2] in structure.channels


def _is_index(file: McapFile, start: int, end: int) -> bool:
    """True for an index of messages. A chunk with a damaged first byte may look like one, but what follows its
    list is longer than what a later version of MCAP may add."""
    length = end - start - RECORD.size
    if length < 6:
        return False
    list_bytes = int.from_bytes(file.read(start + RECORD.size + 2, 4), "little")
    return 0 <= length - 6 - list_bytes < RECORDS_AT - RECORD.size - 6


def _is_of_unknown_kind(file: McapFile, start: int, end: int) -> bool:
    """True for a record of another program's own kind, or of a later version of MCAP. A chunk with a damaged
    first byte is none."""
    head = file.read(start + 1, min(RECORDS_AT, end - start) - 1)
    return not file.promises_crcs and _CHUNK_START.match(bytes([Opcode.CHUNK]) + head) is None


def next_chunk(file: McapFile, position: int) -> int:
    """Offset of the next bytes that look like a chunk; the file's size without any."""
    while position < file.size:
        block = file.read(position, min(_SEARCH_BYTES + 64, file.size - position))
        if (match := _CHUNK_START.search(block)) is not None:
            return position + match.start()
        position += _SEARCH_BYTES
    return file.size


def _add_definition(
    file: McapFile, opcode: int, content: bytes, structure: Structure, *, exactly: bool = False
) -> None:
    """`exactly`: accept only bytes as a writer writes them, before those that a later version of MCAP may add.
    Outside chunks, no CRC protects a definition."""
    kind: type[Schema | Channel] = Schema if opcode == Opcode.SCHEMA else Channel
    record = file.parsed(kind, content, "a schema or channel")
    if exactly and not content.startswith(_written(record)):
        raise file.damaged("no schema or channel")
    if isinstance(record, Schema):
        structure.schemas.setdefault(record.id, record)
    else:
        structure.channels.setdefault(record.id, record)


def add_definitions(file: McapFile, records: bytes, structure: Structure) -> None:
    for opcode, start, end in file.parts(records).definitions:
        _add_definition(file, opcode, records[start + RECORD.size : end], structure)


def _written(record: Schema | Channel) -> bytes:
    """The content of a record, as a writer writes it."""
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    return written[RECORD.size :]
