"""Bytes at the end of records, and records of unknown kinds: MCAP allows both, and readers pass over them."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Final

import pytest
from mcap.stream_reader import StreamReader

from recorder import Log
from recorder.log_cli import main
from recorder.topics import LIBRARY
from recorder.upkeep.check import check
from tests.helpers.mcap_conformance import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MESSAGE,
    STATISTICS,
)
from tests.helpers.udacity import call

ADDED: Final = b"\1\xff\xff"
PRIVATE: Final = 0x80
TIMES_NS: Final = [1, 2, 3]


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def file(
    *,
    is_chunked: bool,
    has_summary: bool,
    after_chunk: bytes = b"",
    after_end: bytes = b"",
    other: bytes = b"",
    data_crc: bool = True,
    library: str = "",
) -> bytes:
    """Three messages on /n. `after_chunk` and `after_end` end the chunk and the record DataEnd, `other` is between
    records."""
    channel = record(CHANNEL, struct.pack("<HH", 1, 0) + text("/n") + text("json") + bytes(4))
    messages = [record(MESSAGE, struct.pack("<HIQQ", 1, ns, ns, ns) + b"{}") for ns in TIMES_NS]
    data = MAGIC + record(HEADER, text("") + text(library)) + other
    summary = channel + record(STATISTICS, struct.pack("<QHIIIIQQIHQ", 3, 0, 1, 0, 0, is_chunked, 1, 3, 10, 1, 3))
    if is_chunked:
        inner = channel + other + b"".join(messages)
        head = struct.pack("<QQQI", 1, 3, len(inner), zlib.crc32(inner)) + text("")
        chunk = record(CHUNK, head + struct.pack("<Q", len(inner)) + inner + after_chunk)
        place = struct.pack("<QQQQIQ", 1, 3, len(data), len(chunk), 0, 0)
        summary += record(CHUNK_INDEX, place + text("") + struct.pack("<QQ", len(inner), len(inner)))
        data += chunk + other
    else:
        data += other.join([channel, *messages, b""])
    data += record(DATA_END, struct.pack("<I", zlib.crc32(data) if data_crc else 0) + after_end)
    if not has_summary:
        summary = b""
    footer = record(FOOTER, struct.pack("<QQI", len(data) if has_summary else 0, 0, 0))[:-4]
    return data + summary + footer + struct.pack("<I", zlib.crc32(summary + footer)) + MAGIC


@pytest.mark.parametrize("has_summary", [True, False])
@pytest.mark.parametrize("is_chunked", [True, False])
@pytest.mark.parametrize(
    "added",
    [
        {"after_chunk": ADDED},
        {"after_end": ADDED},
        {"after_end": ADDED * 100},
        {"other": record(PRIVATE, ADDED)},
        {"other": record(0x10, b"") + record(0xFF, ADDED * 100)},
    ],
    ids=["chunk", "data end", "long data end", "private record", "unknown records"],
)
def test_what_mcap_lets_others_add_is_passed_over(
    added: dict[str, bytes], is_chunked: bool, has_summary: bool, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(file(is_chunked=is_chunked, has_summary=has_summary, **added))  # type: ignore[arg-type]
    with path.open("rb") as stream:
        assert list(StreamReader(stream, validate_crcs=True).records)  # mcap's own reader takes it
    with Log(path) as log:
        assert (log.notice, log.lost, log.counts) == ("", [], {"/n": 3})
        assert [message.log_time_ns for message in log.messages("/n")] == TIMES_NS
        assert [content for _, content in log.contents("/n")] == [b"{}"] * 3
    assert call(main, "check", path) == 0


def test_our_own_logs_have_no_other_records(tmp_path: Path) -> None:
    """There, an unknown record is damage."""
    path = tmp_path / "a.mcap"
    path.write_bytes(file(is_chunked=True, has_summary=False, other=record(PRIVATE, ADDED), library=LIBRARY))
    assert check(path).is_damaged
