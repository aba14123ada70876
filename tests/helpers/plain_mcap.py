"""MCAP files as mcap's own package reads and writes them: what ours are held against."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.records import Attachment, Channel, Chunk, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from mcap_protobuf.schema import register_schema

from recorder.bc_pb2 import VehicleState


class Stored(NamedTuple):
    """A message with all that a log knows of it."""

    topic: str
    schema: str
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


class StoredChunk(NamedTuple):
    """A chunk, where in the file it lies, and its messages in their order."""

    start: int
    end: int
    messages: list[Stored]


class Contents(NamedTuple):
    """All that is in a file."""

    profile: str
    chunks: list[StoredChunk]
    metadata: list[tuple[str, dict[str, str]]]
    attachments: list[tuple[str, bytes]]

    @property
    def messages(self) -> list[Stored]:
        return [message for chunk in self.chunks for message in chunk.messages]

    @property
    def by_topic(self) -> dict[str, list[Stored]]:
        return by_topic(self.messages)

    def of(self, *topics: str) -> list[Stored]:
        return [message for message in self.messages if message.topic in topics]


def by_topic(messages: Iterable[Stored]) -> dict[str, list[Stored]]:
    """Messages in their order within each topic, which is all the order that a log keeps."""
    found: dict[str, list[Stored]] = {}
    for message in messages:
        found.setdefault(message.topic, []).append(message)
    return found


def contents(path: Path) -> Contents:
    """Every record from the first byte to the last, in the order of the file, with every CRC checked.

    Raises McapError or ValueError where anything is wrong.
    """
    found = Contents("", [], [], [])
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}

    def stored(message: Message) -> Stored:
        channel = channels[message.channel_id]
        schema = schemas[channel.schema_id].name if channel.schema_id else ""
        return Stored(
            channel.topic, schema, message.sequence, message.log_time, message.publish_time, message.data
        )

    data, position = path.read_bytes(), 8
    with path.open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=True, validate_crcs=True)
        for record in reader.records:
            if isinstance(record, Header):
                found = found._replace(profile=record.profile)
            elif isinstance(record, Chunk):
                messages = []
                for inner in breakup_chunk(record, validate_crc=True):
                    if isinstance(inner, Schema):
                        schemas[inner.id] = inner
                    elif isinstance(inner, Channel):
                        channels[inner.id] = inner
                    elif isinstance(inner, Message):
                        messages.append(stored(inner))
                position = data.index(_chunk_start(record), position)
                end = position + 9 + 40 + len(record.compression) + len(record.data)
                found.chunks.append(StoredChunk(position, end, messages))
                position = end
            elif isinstance(record, Metadata):
                found.metadata.append((record.name, record.metadata))
            elif isinstance(record, Attachment):
                found.attachments.append((record.name, record.data))
    return found


def _chunk_start(chunk: Chunk) -> bytes:
    length = 40 + len(chunk.compression) + len(chunk.data)
    return b"\x06" + length.to_bytes(8, "little") + chunk.message_start_time.to_bytes(8, "little")


@contextmanager
def plain_writer(path: Path, profile: str = "", library: str = "", **options: Any) -> Iterator[McapWriter]:
    """mcap's own writer of a new file, which is finished at the end."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, **options)
        writer.start(profile, library)
        yield writer
        writer.finish()  # type: ignore[no-untyped-call]


class CopiedTopics:
    """Adds messages of other logs to one, and each of their topics once."""

    def __init__(self, writer: McapWriter) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def channel(self, schema: Schema | None, channel: Channel) -> int:
        """The number of a topic in the new log."""
        if channel.topic not in self._channels:
            assert schema is not None
            if schema.name not in self._schemas:
                self._schemas[schema.name] = self._writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            self._channels[channel.topic] = self._writer.register_channel(
                channel.topic, channel.message_encoding, self._schemas[schema.name], channel.metadata
            )
        return self._channels[channel.topic]

    def add(self, schema: Schema | None, channel: Channel, message: Message) -> None:
        number = self.channel(schema, channel)
        self._writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)


def write_plain(
    path: Path,
    compression: CompressionType,
    rows: Iterable[int],
    *,
    chunk_bytes: int = 1024,
    use_chunking: bool = True,
    picture: bytes = b"picture of row %d, " * 20,
    enable_crcs: bool = True,
) -> Path:
    """A log of centre pictures and vehicle states, written by mcap alone."""
    options: dict[str, Any] = {"chunk_size": chunk_bytes, "compression": compression, "use_chunking": use_chunking}
    with plain_writer(path, enable_crcs=enable_crcs, enable_data_crcs=enable_crcs, **options) as writer:
        image = writer.register_channel("/camera/center", "protobuf", register_schema(writer, CompressedImage))
        state = writer.register_channel("/vehicle", "protobuf", register_schema(writer, VehicleState))
        for row in rows:
            time_ns = 1_720_880_000_000_000_000 + row * 100_000_000
            data = picture.replace(b"%d", b"%d" % row)
            message = CompressedImage(data=data, format="jpeg").SerializeToString()
            writer.add_message(image, time_ns, message, time_ns, row)
            writer.add_message(state, time_ns, VehicleState(steering=row / 10).SerializeToString(), time_ns, row)
    return path
