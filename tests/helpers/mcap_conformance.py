"""The files of MCAP's conformance suite: six small inputs, each written with every combination of optional parts.

As https://github.com/foxglove/mcap/tree/main/tests/conformance generates them, byte for byte; laid out by
https://mcap.dev/spec alone, without a package that writes MCAP.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Iterator
from typing import Final, NamedTuple

MAGIC: Final = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
FEATURES: Final = ("ch", "mx", "st", "rsh", "rch", "ax", "mdx", "chx", "sum", "pad")
"""Chunks, message indexes, statistics, schemas and channels again in the summary, indexes of attachments, metadata
and chunks, summary offsets, and bytes of a later version at the end of records."""
_PADDING: Final = b"\x01\xff\xff"
_GROUPS: Final = (SCHEMA, CHANNEL, STATISTICS, METADATA_INDEX, ATTACHMENT_INDEX, CHUNK_INDEX)  # as in the file

SCHEMAS: Final = [(1, "Example", "c", bytes([4, 5, 6]))]  # number, name, encoding, data
CHANNELS: Final = [(1, 1, "example", "a", {"foo": "bar"})]  # number, schema, topic, encoding, metadata
ONE: Final = [(10, 2, 1)]  # sequence, log time, publish time
TEN: Final = [(number, time, time) for number, time in enumerate([0, 2, 1, 3, 3, 5, 4, 7, 8, 9])]
DATA: Final = bytes([1, 2, 3])  # of messages and attachments


class Input(NamedTuple):
    """What a file holds."""

    name: str
    schemas: list[tuple[int, str, str, bytes]] = []  # noqa: RUF012
    channels: list[tuple[int, int, str, str, dict[str, str]]] = []  # noqa: RUF012
    messages: list[tuple[int, int, int]] = []  # noqa: RUF012
    attachments: list[str] = []  # noqa: RUF012
    metadata: list[tuple[str, dict[str, str]]] = []  # noqa: RUF012


INPUTS: Final = (
    Input("NoData"),
    Input("OneSchemalessMessage", channels=[(1, 0, "example", "text", {})], messages=ONE),
    Input("OneMessage", SCHEMAS, CHANNELS, ONE),
    Input("OneAttachment", attachments=["myFile"]),
    Input("OneMetadata", metadata=[("myMetadata", {"foo": "bar"})]),
    Input("TenMessages", SCHEMAS, CHANNELS, TEN),
)


def variants() -> Iterator[tuple[str, Input, bytes]]:
    """Name, contents and bytes of each of the 416 files."""
    for given in INPUTS:
        for size in range(len(FEATURES) + 1):
            for features in itertools.combinations(sorted(FEATURES), size):
                if _make_sense(given, set(features)):
                    yield "-".join([given.name, *features]), given, _file(given, set(features))


def _make_sense(given: Input, features: set[str]) -> bool:
    lacking = {
        "ax": not given.attachments,
        "mdx": not given.metadata,
        "rsh": not given.schemas,
        "rch": not given.channels,
        "ch": not given.channels,
        "chx": "ch" not in features,
        "mx": "ch" not in features,
        "sum": not features & {"chx", "rsh", "rch", "mdx", "ax", "st"},
    }
    return not any(lacking.get(feature) for feature in features)


def _file(given: Input, features: set[str]) -> bytes:
    padding = _PADDING * ("pad" in features)

    def record(opcode: int, content: bytes, end: bytes = padding) -> bytes:
        return struct.pack("<BQ", opcode, len(content + end)) + content + end

    schemas, channels, messages = _records(given, padding * ("ch" not in features))
    data = MAGIC + record(HEADER, _text("") + _text(""))
    summary: dict[int, bytes] = {}  # groups by opcode
    if "rsh" in features:
        summary[SCHEMA] = b"".join(_records(given, padding)[0])
    if "rch" in features:
        summary[CHANNEL] = b"".join(_records(given, padding)[1])
    if "st" in features:
        summary[STATISTICS] = record(STATISTICS, _statistics(given, "ch" in features))
    if "ch" not in features:
        data += b"".join([*schemas, *channels, *messages])
    for name in given.attachments:
        head = struct.pack("<QQ", 2, 1)  # log time, create time
        content = head + _text(name) + _text("application/octet-stream") + struct.pack("<Q", len(DATA)) + DATA
        attachment = record(ATTACHMENT, content + struct.pack("<I", zlib.crc32(content)))
        if "ax" in features:
            place = struct.pack("<QQ", len(data), len(attachment)) + head + struct.pack("<Q", len(DATA))
            summary[ATTACHMENT_INDEX] = record(
                ATTACHMENT_INDEX, place + _text(name) + _text("application/octet-stream")
            )
        data += attachment
    for name, values in given.metadata:
        metadata = record(METADATA, _text(name) + _map(values))
        if "mdx" in features:
            place = struct.pack("<QQ", len(data), len(metadata))
            summary[METADATA_INDEX] = record(METADATA_INDEX, place + _text(name))
        data += metadata
    if "ch" in features:
        content = b"".join([*schemas, *channels, *messages])
        times = struct.pack("<QQ", *_times(given))
        sizes = struct.pack("<QI", len(content), zlib.crc32(content)) + _text("")
        chunk_at = len(data)
        data += record(CHUNK, times + sizes + struct.pack("<Q", len(content)) + content, b"")
        chunk_bytes, index_at, indexes, places = len(data) - chunk_at, len(data), b"", b""
        if "mx" in features:
            at = len(b"".join([*schemas, *channels]))
            for (_, time_ns, _), message in zip(given.messages, messages, strict=True):
                places += struct.pack("<QQ", time_ns, at)
                at += len(message)
            indexes = record(MESSAGE_INDEX, struct.pack("<HI", 1, len(places)) + places)
            places = struct.pack("<HQ", 1, index_at)
            data += indexes
        if "chx" in features:
            summary[CHUNK_INDEX] = record(
                CHUNK_INDEX,
                times
                + struct.pack("<QQI", chunk_at, chunk_bytes, len(places))
                + places
                + struct.pack("<Q", len(indexes))
                + _text("")
                + struct.pack("<QQ", len(content), len(content)),
            )
    data += record(DATA_END, struct.pack("<I", zlib.crc32(data)), b"")
    start, groups, offsets, offsets_at = len(data), b"", b"", 0
    for opcode in _GROUPS:
        if opcode in summary:
            place = struct.pack("<BQQ", opcode, start + len(groups), len(summary[opcode]))
            offsets += record(SUMMARY_OFFSET, place)
            groups += summary[opcode]
    if "sum" in features:
        offsets_at, groups = start + len(groups), groups + offsets
    footer = record(FOOTER, struct.pack("<QQI", start if groups else 0, offsets_at, 0), b"")[:-4]
    return data + groups + footer + struct.pack("<I", zlib.crc32(groups + footer)) + MAGIC


def _records(given: Input, padding: bytes) -> tuple[list[bytes], list[bytes], list[bytes]]:
    """Schemas, channels and messages; a message's data goes to its record's end."""
    schemas = [
        struct.pack("<H", number) + _text(name) + _text(encoding) + struct.pack("<I", len(data)) + data + padding
        for number, name, encoding, data in given.schemas
    ]
    channels = [
        struct.pack("<HH", number, schema) + _text(topic) + _text(encoding) + _map(metadata) + padding
        for number, schema, topic, encoding, metadata in given.channels
    ]
    messages = [
        struct.pack("<HIQQ", 1, sequence, log_time, publish_time) + DATA
        for sequence, log_time, publish_time in given.messages
    ]
    kinds = ((SCHEMA, schemas), (CHANNEL, channels), (MESSAGE, messages))
    first, second, third = (
        [struct.pack("<BQ", opcode, len(content)) + content for content in contents] for opcode, contents in kinds
    )
    return first, second, third


def _statistics(given: Input, has_chunk: bool) -> bytes:
    counts = [len(given.messages), len(given.schemas), len(given.channels), len(given.attachments)]
    of_channels = struct.pack("<HQ", 1, len(given.messages)) if given.messages else b""
    content = struct.pack("<QHIIII", *counts, len(given.metadata), has_chunk)
    return content + struct.pack("<QQI", *_times(given), len(of_channels)) + of_channels


def _times(given: Input) -> tuple[int, int]:
    times = [log_time for _, log_time, _ in given.messages] or [0]
    return min(times), max(times)


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _map(values: dict[str, str]) -> bytes:
    content = b"".join(_text(text) for pair in values.items() for text in pair)
    return struct.pack("<I", len(content)) + content
