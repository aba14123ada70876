"""Writes an MCAP file with pictures in separate chunks, so that other messages are read without them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from hashlib import sha256
from typing import BinaryIO, Final, cast

from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from recorder.mcap.mcap_file import CHUNK_HEADER, MESSAGE
from recorder.mcap.picture_places import PLACES_AT_ONCE, PlacesWritten

CHUNK_BYTES: Final = 256 * 1024
ROWS_CHUNK_BYTES: Final = 32 * 1024
"""The size of chunks without pictures, some 500 rows: a wrong bit, or a copy that is cut off, costs no more rows.
There is still only one of these chunks for a hundred with pictures."""
_CHUNK: Final = bytes([Opcode.CHUNK])  # the first byte of its record


class SplitChunks:
    """Writes messages into chunks of two kinds: pictures, and everything else.

    The MCAP library's open chunk holds pictures. Other messages wait until they fill a chunk or are flushed. They
    are written after all earlier pictures, so that a file that is cut off has no row without its pictures.
    Messages of one topic stay in order.
    """

    def __init__(self, stream: BinaryIO, *, is_split: bool) -> None:
        """`is_split`: False mixes pictures and other messages in the same chunks."""
        self._is_split = is_split
        self._stream = _ChunkStream(stream)
        self.mcap = Writer(
            cast(BinaryIO, self._stream),  # the library uses only its methods
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.NONE,
            enable_data_crcs=True,
        )
        """For everything but messages: the file's start, channels, schemas, metadata, attachments."""
        self._waiting = deque[tuple[Callable[[], int], int, bytes, int, int]]()  # arguments of `add`
        self._waiting_bytes = 0

    @property
    def content_digest(self) -> str:
        """SHA-256 over the headers of all chunks until now, without the open chunk."""
        return self._stream.digest.hexdigest()

    def add(
        self,
        number_of: Callable[[], int],
        log_time_ns: int,
        data: bytes,
        publish_time_ns: int,
        sequence: int,
        *,
        is_picture: bool,
    ) -> None:
        """Add a message to the channel with the number from `number_of`, which may register the channel."""
        if self._is_split and not is_picture:
            self._waiting.append((number_of, log_time_ns, data, publish_time_ns, sequence))
            self._waiting_bytes += len(data) + MESSAGE.size
            if self._waiting_bytes > min(CHUNK_BYTES, ROWS_CHUNK_BYTES):
                self.flush()
            return
        number = number_of()
        if self._is_split:
            self._stream.places.channels.add(number)
        self.mcap.add_message(number, log_time_ns, data, publish_time_ns, sequence)
        if self._stream.places.count >= PLACES_AT_ONCE:
            self._write_places()

    def flush(self) -> None:
        """Close the open chunk of pictures, then the other one."""
        self.mcap.flush()  # type: ignore[no-untyped-call]
        if self._waiting:
            self._waiting_bytes = 0
            while self._waiting:  # one by one: if this is interrupted, as by Ctrl-C, the others still wait
                number_of, log_time_ns, data, publish_time_ns, sequence = self._waiting.popleft()
                self.mcap.add_message(number_of(), log_time_ns, data, publish_time_ns, sequence)
            self.mcap.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """Write the lists of pictures and chunks, and the summary. Nothing may be written afterwards."""
        self.flush()
        if self._stream.places.channels:
            self._write_places()
            self.mcap.add_attachment(*self._stream.places.take_chunks())
        self.mcap.finish()  # type: ignore[no-untyped-call]

    def _write_places(self) -> None:
        self.mcap.add_attachment(*self._stream.places.take_pictures())


class _ChunkStream:
    """Passes the MCAP library's output to a file, and notes the contents of each chunk.

    The library writes a chunk in one call.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.places = PlacesWritten()
        self.digest = sha256()
        self.flush = stream.flush
        self.tell = stream.tell

    def write(self, data: bytes) -> int:
        if data[:1] == _CHUNK:
            self.digest.update(data[: CHUNK_HEADER.size])
            self.places.add_chunk(self._stream.tell(), data)
        return self._stream.write(data)


class CopiedChannels:
    """Registers each channel once: merged logs share equal channels."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._by_id: dict[int, tuple[Channel, int]] = {}
        self._channels: dict[tuple[object, ...], int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}

    def number_of(self, schema: Schema | None, channel: Channel) -> int:
        """The number in this log of a channel of another log."""
        entry = self._by_id.get(id(channel))
        if entry is None:
            # a kept channel's id is not reused
            entry = self._by_id[id(channel)] = (channel, self._register(schema, channel))
        return entry[1]

    def _register(self, schema: Schema | None, channel: Channel) -> int:
        metadata = dict(channel.metadata)
        number = self._register_schema(schema)
        key = (channel.topic, channel.message_encoding, number, *sorted(metadata.items()))
        if key not in self._channels:
            self._channels[key] = self._writer.register_channel(
                channel.topic, channel.message_encoding, number, metadata
            )
        return self._channels[key]

    def _register_schema(self, schema: Schema | None) -> int:
        if schema is None:
            return 0  # in MCAP: no schema
        key = (schema.name, schema.encoding, schema.data)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(*key)
        return self._schemas[key]
