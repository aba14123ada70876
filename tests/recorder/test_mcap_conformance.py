"""MCAP's conformance suite: all 416 files are read as what they are, finished and undamaged."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any, Final

import pytest
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from recorder import Log
from recorder.log_cli import main
from recorder.topics import LIBRARY
from recorder.upkeep.check import check
from recorder.upkeep.recover import recover
from tests.helpers.mcap_conformance import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA,
    DATA_END,
    FOOTER,
    HEADER,
    INPUTS,
    MAGIC,
    MESSAGE,
    STATISTICS,
    Input,
    variants,
)
from tests.helpers.udacity import call

Held = tuple[list[Any], list[Any], list[Any], list[Any], list[Any]]


def given_in(given: Input) -> Held:
    """Schemas, channels, messages, attachments and metadata."""
    messages = [(1, *numbers, DATA) for numbers in given.messages]
    attachments = [(name, "application/octet-stream", 2, 1, DATA) for name in given.attachments]
    return given.schemas, given.channels, messages, attachments, given.metadata


def read_from(path: Path) -> Held:
    with Log(path) as log:
        stored = [part for chunk in log.chunks for part in log.messages_of(chunk)]
        attachments = [log.attachment(offset) for offset in log.attachments]
        assert sum(log.counts.values()) == len(stored)
        if stored:
            times = [message.log_time for _, _, message in stored]
            assert log.time_range_ns == (min(times), max(times))
            assert [message.log_time_ns for message in log.messages("example")] == times
        return in_plain_data(
            [schema for schema, _, _ in stored if schema is not None],
            list(log.channels.values()),
            [message for _, _, message in stored],
            attachments,
            list(log.all_metadata),
        )


def in_plain_data(
    schemas: list[Schema],
    channels: list[Channel],
    messages: list[Message],
    attachments: list[Attachment],
    metadata: list[tuple[str, dict[str, str]]],
) -> Held:
    """Each schema and channel once: the summary may repeat them."""
    by_number = {schema.id: (schema.id, schema.name, schema.encoding, schema.data) for schema in schemas}
    topics = {
        its.id: (its.id, its.schema_id, its.topic, its.message_encoding, dict(its.metadata)) for its in channels
    }
    return (
        list(by_number.values()),
        list(topics.values()),
        [(its.channel_id, its.sequence, its.log_time, its.publish_time, its.data) for its in messages],
        [(its.name, its.media_type, its.log_time, its.create_time, its.data) for its in attachments],
        metadata,
    )


def read_by_mcap(path: Path) -> Held:
    """What mcap's own reader finds."""
    with path.open("rb") as stream:
        records = list(StreamReader(stream, validate_crcs=True).records)
    return in_plain_data(
        [record for record in records if isinstance(record, Schema)],
        [record for record in records if isinstance(record, Channel)],
        [record for record in records if isinstance(record, Message)],
        [record for record in records if isinstance(record, Attachment)],
        [(record.name, record.metadata) for record in records if isinstance(record, Metadata)],
    )


@pytest.mark.parametrize("given", INPUTS, ids=lambda given: given.name)
def test_every_file_is_read_as_what_it_is(given: Input, tmp_path: Path) -> None:
    paths, complaints = list[Path](), list[object]()
    for name, _, data in (variant for variant in variants() if variant[1] is given):
        path = tmp_path / f"{name}.mcap"
        path.write_bytes(data)
        paths.append(path)
        assert read_by_mcap(path) == given_in(given)
        with Log(path) as log:
            verdict = (log.problem, log.lost, check(path).findings)
        if verdict != ("", [], []) or read_from(path) != given_in(given):
            complaints.append((name, *verdict, read_from(path)))
    assert complaints == []
    assert call(main, "info", *paths) == 0
    assert call(main, "check", *paths) == 0


@pytest.mark.parametrize("features", ["", "-pad", "-pad-st", "-ch", "-ch-mx-pad", "-ch-chx-rch-rsh-st"])
def test_what_is_read_can_be_recovered_and_what_is_cut_off_is_still_named(features: str, tmp_path: Path) -> None:
    [(given, data)] = [(given, data) for name, given, data in variants() if name == f"TenMessages{features}"]
    path, cut_off = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(data)
    assert read_by_mcap(recover(path, tmp_path / "recovered.mcap").path) == given_in(given)
    for missing in (1, 8, 20, 40):  # of the magic bytes, of the footer, of the summary or the data section
        cut_off.write_bytes(data[:-missing])
        with Log(cut_off) as log:
            assert log.problem
        assert call(main, "check", cut_off) == 3
    assert read_from(cut_off)[:3] == given_in(given)[:3]


def test_a_damaged_chunk_is_named_and_not_the_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    [data] = [data for variant, _, data in variants() if variant == "OneMessage-ch"]
    path = tmp_path / "a.mcap"
    path.write_bytes(data.replace(DATA, b"\1\2\4"))
    assert call(main, "info", path) == 3
    assert f"{path}: damaged; its complete parts are read" in capsys.readouterr().err
    assert [finding.kind for finding in check(path).findings] == ["unreadable bytes"]


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
