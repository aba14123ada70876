"""Logs of both layouts: as they are written now, and as the versions before wrote them."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from plain_mcap import contents

Layout = Callable[[Path], Path]
"""Takes a log that was just written, and gives it its layout."""

CHUNK_BYTES = 256 * 1024
Stored = tuple[Schema | None, Channel, Message]


def two_kinds(path: Path) -> Path:
    """Pictures in chunks of their own, and everything else in others: as it was written."""
    return path


def mixed(path: Path, chunk_bytes: int = CHUNK_BYTES) -> Path:
    """The same messages as the versions before wrote them, by mcap alone: row after row, in the same chunks."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        header = reader.get_header()
        stored = [*reader.iter_messages(log_time_order=False)]
    session, *rest = contents(path).metadata
    parts: list[list[Stored]] = [[] for _ in range(4)]
    for one in stored:
        parts[_place_in_row(one[1].topic)].append(one)
    data = path.with_name(f"{path.name}.mixed")
    with data.open("wb") as stream:
        writer = McapWriter(
            stream, chunk_size=chunk_bytes, compression=CompressionType.NONE, enable_data_crcs=True
        )
        writer.start(profile=header.profile, library=header.library)
        writer.add_metadata(*session)
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for schema, channel, message in heapq.merge(*parts, key=lambda one: one[2].log_time):
            assert schema is not None
            if channel.topic not in channels:
                if schema.name not in schemas:
                    schemas[schema.name] = writer.register_schema(schema.name, schema.encoding, schema.data)
                number = schemas[schema.name]
                channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, number)
            number = channels[channel.topic]
            writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)
        for record in rest:
            writer.add_metadata(*record)
        writer.finish()  # type: ignore[no-untyped-call]
    data.replace(path)
    return path


def _place_in_row(topic: str) -> int:
    """As drives and imports write them."""
    if topic.startswith("/camera/"):
        return 0
    return {"/vehicle": 1, "/pilot/input": 2}.get(topic, 3)
