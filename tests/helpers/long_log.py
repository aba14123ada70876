"""A finished log of any length, whose pictures are a hole in the file: of the disk it takes its end alone."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Statistics, SummaryOffset

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
CHUNK_BYTES = 256 * 1024
MAP = struct.pack("<HQ", 1, 0) * 3  # of three cameras
CHUNK_INDEX = struct.Struct(f"<BQQQQQI{len(MAP)}sQIQQ")


def lengthened(log: Path, path: Path, chunks: int) -> Path:
    """A log with so many chunks more behind those it has, with nothing in them."""
    data = log.read_bytes()
    start, offsets_start = struct.unpack_from("<QQ", data, len(data) - len(MAGIC) - 20)
    groups = _groups(data[start:offsets_start])
    # the CRCs of all chunks are the last attachment, and the last record of the data
    *_, crcs_at = (number for number in range(start) if data.startswith(b"bc.chunks", number))
    crcs_at -= HEAD.size + 16 + 4
    crcs = Attachment.read(ReadDataStream(io.BytesIO(data[crcs_at + HEAD.size : start])))
    starts = range(crcs_at, crcs_at + chunks * CHUNK_BYTES, CHUNK_BYTES)
    crcs.data += b"".join(struct.pack("<QI", each, 0) for each in starts)
    attachment = _written(crcs)
    groups[Opcode.ATTACHMENT_INDEX] = groups[Opcode.ATTACHMENT_INDEX].replace(
        struct.pack("<Q", crcs_at), struct.pack("<Q", starts.stop)
    )
    groups[Opcode.CHUNK_INDEX] += b"".join(
        CHUNK_INDEX.pack(
            Opcode.CHUNK_INDEX, CHUNK_INDEX.size - HEAD.size, 0, 0, each, CHUNK_BYTES,
            len(MAP), MAP, 0, 0, CHUNK_BYTES, CHUNK_BYTES,
        )
        for each in starts
    )  # fmt: skip
    statistics = Statistics.read(ReadDataStream(io.BytesIO(groups[Opcode.STATISTICS][HEAD.size :])))
    statistics.chunk_count += chunks
    groups[Opcode.STATISTICS] = _written(statistics)

    behind = attachment + HEAD.pack(Opcode.DATA_END, 4) + bytes(4)
    end = starts.stop + len(behind)  # of all data
    summary, offsets = b"", b""
    for opcode, records in groups.items():
        offsets += _written(SummaryOffset(opcode, group_start=end + len(summary), group_length=len(records)))
        summary += records
    footer = HEAD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", end, end + len(summary))
    crc = struct.pack("<I", zlib.crc32(summary + offsets + footer))
    with path.open("wb") as stream:
        stream.write(data[:crcs_at])
        stream.seek(starts.stop)
        stream.write(behind + summary + offsets + footer + crc + MAGIC)
    return path


def _groups(summary: bytes) -> dict[int, bytes]:
    """The records of each kind."""
    groups: dict[int, bytes] = {}
    position = 0
    while position < len(summary):
        opcode, length = HEAD.unpack_from(summary, position)
        end = position + HEAD.size + length
        groups[opcode] = groups.get(opcode, b"") + summary[position:end]
        position = end
    return groups


def _written(record: Attachment | Statistics | SummaryOffset) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    return written
