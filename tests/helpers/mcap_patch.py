"""Sound MCAP files that tell something else at their end: every CRC holds, and every chunk is where it was."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, ChunkIndex, McapRecord, Statistics

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")


def patched(
    path: Path,
    attachment: Callable[[str, bytes], bytes | None] = lambda _, content: content,
    summary: Callable[[McapRecord], None] = lambda _: None,
    within: int = 0,
) -> Path:
    """Gives each attachment another content, or none at all where that is None; `summary` may change the chunk
    indexes and the statistics. Of the first attachment, the summary also lists `within` that are its content, one
    within the other (`nested`)."""
    data, position = path.read_bytes(), len(MAGIC)
    body, end, indexes = bytearray(MAGIC), bytearray(), list[AttachmentIndex]()
    is_summary = False
    while True:
        opcode, length = HEAD.unpack_from(data, position)
        content = data[position + HEAD.size : position + HEAD.size + length]
        record = data[position : position + HEAD.size + length]
        position += len(record)
        if opcode == Opcode.FOOTER:
            break
        if opcode == Opcode.DATA_END:
            is_summary = True
        elif not is_summary and opcode == Opcode.ATTACHMENT:
            found = Attachment.read(ReadDataStream(io.BytesIO(content)))
            new = attachment(found.name, found.data)
            if new is not None:
                found.data = new
                written = _written(found)
                indexes.append(
                    AttachmentIndex(
                        offset=len(body),
                        length=len(written),
                        create_time=found.create_time,
                        log_time=found.log_time,
                        data_size=len(new),
                        name=found.name,
                        media_type=found.media_type,
                    )
                )
                body += written
        elif not is_summary:
            body += record
        elif opcode in (Opcode.CHUNK_INDEX, Opcode.STATISTICS):
            kind = ChunkIndex if opcode == Opcode.CHUNK_INDEX else Statistics
            of_summary = kind.read(ReadDataStream(io.BytesIO(content)))
            if isinstance(of_summary, Statistics):
                of_summary.attachment_count = len(indexes) + within
            summary(of_summary)
            end += _written(of_summary)
        elif opcode not in (Opcode.ATTACHMENT_INDEX, Opcode.SUMMARY_OFFSET):
            end += record
    for index in indexes:
        end += _written(index)
    for depth in range(1, within + 1):
        first = indexes[0]
        end += _written(replace(first, offset=first.offset + depth * (len(nested(first.name, b"", 1)) - 4)))
    body += HEAD.pack(Opcode.DATA_END, 4) + struct.pack("<I", zlib.crc32(body))
    end += HEAD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", len(body), 0)
    path.write_bytes(body + end + struct.pack("<I", zlib.crc32(end)) + MAGIC)
    return path


def nested(name: str, content: bytes, depth: int) -> bytes:
    """An attachment with this content, as the content of another one, and so on."""
    for _ in range(depth):
        content = _written(Attachment(0, 0, name, "application/octet-stream", content))
    return content


def _written(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    return written
