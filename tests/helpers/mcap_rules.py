"""What MCAP's specification demands of a finished file, each rule checked against the bytes themselves.

https://mcap.dev/spec. Records are taken apart by mcap's own package; where they lie, what belongs together and
every CRC are found out here, without its readers and without ours. As strict as `mcap doctor`, and stricter: CRCs
may not be missing, every index has to be whole, and every summary offset has to fit its group.
"""

from __future__ import annotations

import io
import itertools
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode, length of the content
IN_DATA = {
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
}
IN_CHUNK = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE}
IN_SUMMARY = {
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
}
KINDS: dict[int, Any] = {
    Opcode.HEADER: records.Header,
    Opcode.FOOTER: records.Footer,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.CHUNK: records.Chunk,
    Opcode.MESSAGE_INDEX: records.MessageIndex,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.ATTACHMENT: records.Attachment,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.STATISTICS: records.Statistics,
    Opcode.METADATA: records.Metadata,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset,
    Opcode.DATA_END: records.DataEnd,
}


class Record(NamedTuple):
    """A record, and where it begins and ends."""

    opcode: int
    start: int
    end: int
    content: Any


@dataclass
class Walk:
    """What a walk over the data section found."""

    broken: list[str] = field(default_factory=list)
    schemas: dict[int, Any] = field(default_factory=dict)
    channels: dict[int, Any] = field(default_factory=dict)
    chunks: list[Any] = field(default_factory=list)  # as their index should be
    attachments: list[Any] = field(default_factory=list)
    metadata: list[Any] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    times: list[int] = field(default_factory=list)


def broken_rules(path: Path) -> list[str]:
    """Every rule that the file breaks, in words."""
    try:
        return _broken_rules(path.read_bytes())
    except (McapError, EOFError, KeyError, MemoryError, OverflowError, ValueError, struct.error) as error:
        return [f"records that cannot be read: {error!r}"]


def _broken_rules(data: bytes) -> list[str]:
    walk = Walk()
    if data[:8] != MAGIC or data[-8:] != MAGIC:
        return ["no magic bytes at both ends"]
    found = list(_records(data, 8, len(data) - 8))
    opcodes = [record.opcode for record in found]
    if opcodes[0] != Opcode.HEADER or opcodes[-1] != Opcode.FOOTER or opcodes.count(Opcode.DATA_END) != 1:
        return ["not a header, a data section, its end, a summary and a footer"]
    end_at = opcodes.index(Opcode.DATA_END)
    section, data_end = found[1:end_at], found[end_at]
    summary = [record for record in found[end_at + 1 : -1] if record.opcode != Opcode.SUMMARY_OFFSET]
    offsets = [record for record in found[end_at + 1 : -1] if record.opcode == Opcode.SUMMARY_OFFSET]
    strange = {each.opcode for each in section} - IN_DATA | {each.opcode for each in summary} - IN_SUMMARY
    if strange:
        return [f"records of opcode {opcode} where none may be" for opcode in sorted(strange)]
    _walk_data(data, section, walk)
    if data_end.content.data_section_crc != zlib.crc32(data[: data_end.start]):
        walk.broken.append("the CRC of the data section does not hold")
    _check_summary(summary, walk)
    _check_end(data, data_end.end, summary, offsets, found[-1], walk)
    return walk.broken


def _records(data: bytes, start: int, end: int) -> Iterator[Record]:
    while start < end:
        opcode, length = HEAD.unpack_from(data, start)
        until = start + HEAD.size + length
        if until > end:
            raise EOFError(f"the record at {start} points beyond {end}")
        stream = ReadDataStream(io.BytesIO(data[start + HEAD.size : until]))
        if opcode == Opcode.MESSAGE:
            content = records.Message.read(stream, length)
        else:
            content = KINDS[opcode].read(stream)
        builder = RecordBuilder()
        content.write(builder)
        if builder.end() != data[start:until]:  # type: ignore[no-untyped-call]
            raise ValueError(f"the record at {start} is not laid out as {content!r}")
        yield Record(opcode, start, until, content)
        start = until


def _walk_data(data: bytes, section: list[Record], walk: Walk) -> None:
    at = 0
    while at < len(section):
        record, at = section[at], at + 1
        if record.opcode == Opcode.CHUNK:
            indexes = list(itertools.takewhile(lambda each: each.opcode == Opcode.MESSAGE_INDEX, section[at:]))
            at += len(indexes)
            _walk_chunk(record, indexes, walk)
        elif record.opcode == Opcode.MESSAGE_INDEX:
            walk.broken.append(f"byte {record.start}: an index of messages without a chunk before it")
        elif record.opcode == Opcode.ATTACHMENT:
            its = record.content
            if data[record.end - 4 : record.end] != struct.pack(
                "<I", zlib.crc32(data[record.start + HEAD.size : record.end - 4])
            ):
                walk.broken.append(f"byte {record.start}: the CRC of the attachment {its.name} does not hold")
            walk.attachments.append(
                records.AttachmentIndex(
                    offset=record.start,
                    length=record.end - record.start,
                    log_time=its.log_time,
                    create_time=its.create_time,
                    data_size=len(its.data),
                    name=its.name,
                    media_type=its.media_type,
                )
            )
        elif record.opcode == Opcode.METADATA:
            length = record.end - record.start
            walk.metadata.append(records.MetadataIndex(record.start, length, record.content.name))
        else:
            _define(record, walk)


def _define(record: Record, walk: Walk) -> None:
    """A schema or channel of the data section."""
    its = record.content
    known = walk.schemas if record.opcode == Opcode.SCHEMA else walk.channels
    if its.id in known:
        walk.broken.append(f"byte {record.start}: {'another' if known[its.id] != its else 'again'}: {its}")
    elif record.opcode == Opcode.SCHEMA and not (its.id and its.encoding):
        walk.broken.append(f"byte {record.start}: a schema without a number or an encoding")
    elif record.opcode == Opcode.CHANNEL and its.schema_id and its.schema_id not in walk.schemas:
        walk.broken.append(f"byte {record.start}: the channel of {its.topic} comes before its schema")
    known[its.id] = its


def _walk_chunk(record: Record, indexes: list[Record], walk: Walk) -> None:
    chunk, where = record.content, f"the chunk at byte {record.start}"
    content: bytes = chunk.data
    if chunk.compression:
        walk.broken.append(f"{where} is compressed")
        return
    if chunk.uncompressed_size != len(content) or chunk.uncompressed_crc != zlib.crc32(content):
        walk.broken.append(f"{where}: its size or its CRC does not hold")
    expected: dict[int, list[tuple[int, int]]] = {}  # as an index has them: log time, offset in the chunk
    for inner in _records(content, 0, len(content)):
        if inner.opcode == Opcode.MESSAGE:
            message = inner.content
            if message.channel_id not in walk.channels:
                walk.broken.append(f"{where}: a message before its channel")
            expected.setdefault(message.channel_id, []).append((message.log_time, inner.start))
        elif inner.opcode in IN_CHUNK:
            _define(inner, walk)
        else:
            walk.broken.append(f"{where}: a record of opcode {inner.opcode}")
    times = [time for entries in expected.values() for time, _ in entries] or [0]
    if (chunk.message_start_time, chunk.message_end_time) != (min(times), max(times)):
        walk.broken.append(f"{where} tells other times than its messages")
    found = [(index.content.channel_id, index.content.records) for index in indexes]
    if len(dict(found)) != len(found) or dict(found) != expected:
        walk.broken.append(f"{where}: the indexes of its messages do not fit")
    walk.counts.update({channel: len(entries) for channel, entries in expected.items()})
    walk.times += times if expected else []
    walk.chunks.append(
        records.ChunkIndex(
            chunk_length=record.end - record.start,
            chunk_start_offset=record.start,
            compression=chunk.compression,
            compressed_size=len(content),
            message_end_time=chunk.message_end_time,
            message_index_length=sum(index.end - index.start for index in indexes),
            message_index_offsets={index.content.channel_id: index.start for index in indexes},
            message_start_time=chunk.message_start_time,
            uncompressed_size=len(content),
        )
    )


def _check_summary(summary: list[Record], walk: Walk) -> None:
    def of(opcode: int) -> list[Any]:
        return [record.content for record in summary if record.opcode == opcode]

    indexes = {
        "chunk": (Opcode.CHUNK_INDEX, walk.chunks),
        "attachment": (Opcode.ATTACHMENT_INDEX, walk.attachments),
        "metadata": (Opcode.METADATA_INDEX, walk.metadata),
    }
    for name, (opcode, expected) in indexes.items():
        if of(opcode) != expected:
            walk.broken.append(f"the {name} indexes are not those of what is there")
    definitions = {"schemas": (Opcode.SCHEMA, walk.schemas), "channels": (Opcode.CHANNEL, walk.channels)}
    for name, (opcode, known) in definitions.items():
        if sorted(of(opcode), key=lambda each: each.id) != [known[number] for number in sorted(known)]:
            walk.broken.append(f"the {name} are not repeated in the summary as they are")
    statistics = records.Statistics(
        attachment_count=len(walk.attachments),
        channel_count=len(walk.channels),
        channel_message_counts=dict(walk.counts),
        chunk_count=len(walk.chunks),
        message_count=walk.counts.total(),
        message_end_time=max(walk.times, default=0),
        message_start_time=min(walk.times, default=0),
        metadata_count=len(walk.metadata),
        schema_count=len(walk.schemas),
    )
    if of(Opcode.STATISTICS) != [statistics]:
        walk.broken.append(f"the statistics are {of(Opcode.STATISTICS)}, not {statistics}")
    unused = walk.channels.keys() - walk.counts.keys()
    walk.broken += [f"nothing is in the channel of {walk.channels[number].topic}" for number in sorted(unused)]


def _check_end(
    data: bytes, summary_start: int, summary: list[Record], offsets: list[Record], footer: Record, walk: Walk
) -> None:
    """Summary offsets, and the footer."""
    groups = []
    for opcode, its_records in itertools.groupby(summary, lambda record: record.opcode):
        group = list(its_records)
        groups.append((opcode, group[0].start, group[-1].end - group[0].start))
    told = [(each.content.group_opcode, each.content.group_start, each.content.group_length) for each in offsets]
    # mcap's own writer tells also of a kind of which there is none: where it would be, and a length of 0
    absent = IN_SUMMARY - {opcode for opcode, _, _ in groups}
    edges = {summary_start} | {start + length for _, start, length in groups}
    some = [each for each in told if each[2] or each[0] not in absent or each[1] not in edges]
    if some != groups:
        walk.broken.append(f"the summary offsets are {told}, not {groups}")
    offset_start = offsets[0].start if offsets else 0
    if any(record.start > offset_start for record in summary):
        walk.broken.append("summary records after the summary offsets")
    expected = records.Footer(
        summary_start=summary_start,
        summary_offset_start=offset_start,
        summary_crc=zlib.crc32(data[summary_start : footer.end - 4]),
    )
    if footer.content != expected:
        walk.broken.append(f"the footer is {footer.content}, not {expected}")
