"""The part of a log that is not drawn, as chunks of a Rerun recording: pictures, and topics that only Rerun knows.

Rerun's reader compares no CRCs, and may never end on a damaged log. Of the toolkit's own logs, it reads only the
summary, and a copy of the topics that it alone knows. This module sends the pictures, and reads each of their
chunks once, with its CRC. A log of another program was already read whole for its index, so Rerun's reader reads
it itself.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import rerun as rr
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError
from mcap.well_known import MessageEncoding
from rerun.chunk import Chunk, McapReader

from common import Skipped
from common.errors import brief
from common.location import local_path
from common.progress import progress_bar
from recorder import Log, LogError, LogWriter
from recorder.errors import damaged_pictures
from recorder.mcap.mcap_file import Chunk as LogChunk
from recorder.mcap.message_index import LAST_TIME_NS
from recorder.topics import COMPRESSED_IMAGE
from viz.timelines import Clock, on_clock

_SENT_BYTES: Final = 1 << 18  # of pictures sent at once: larger parts need more memory in the viewer
_OF_SUMMARY: Final = ("metadata", "recording_info", "schema", "stats")  # decoders of records other than messages
_NOT_OF_SUMMARY: Final = tuple(name for name in McapReader.available_decoders() if name not in _OF_SUMMARY)
_BLOB: Final = pa.list_(pa.field("item", pa.uint8(), nullable=False))


def read_chunks(
    log: Log, drawn: Collection[str], clock: Clock, skipped: Skipped, left_out: str = "", every: int = 1
) -> Generator[Chunk]:
    """The chunks of all topics of a log except `drawn`, on the time lines of `clock`, without the component
    `left_out`. Shows a progress bar. For the toolkit's own logs: the pictures of every `every`-th row, and of the
    last row.

    Pictures that cannot be read are added to `skipped`. Raises LogError if anything else is damaged.
    """
    others = sum(count for topic, count in log.counts.items() if topic not in drawn)
    with progress_bar() as bar:
        task = bar.add_task("sending messages", total=others, note="")
        for chunk in _chunks(log, drawn, clock, skipped, left_out, every):
            yield chunk
            bar.advance(task, 0 if chunk.is_static else len(chunk))


def protobuf_topics(log: Log) -> dict[str, str]:
    schemas = log.schemas
    return {
        channel.topic: schemas[channel.topic]
        for channel in log.channels.values()
        if channel.message_encoding == MessageEncoding.Protobuf
    }


def _chunks(
    log: Log, drawn: Collection[str], clock: Clock, skipped: Skipped, left_out: str, every: int
) -> Iterator[Chunk]:
    if not log.is_ours:
        reader = McapReader(local_path(log.path), exclude_topic_regex=_exactly(drawn))
        yield from on_clock(_read_by_rerun(log, reader), clock, left_out)
        return
    pictures = [topic for topic, schema in protobuf_topics(log).items() if schema == COMPRESSED_IMAGE.name]
    yield from _summary(log, drawn)
    yield from on_clock(_others(log, {*drawn, *pictures}), clock, left_out)
    yield from _pictures(log, pictures, clock, skipped, every)


def _read_by_rerun(log: Log, reader: McapReader) -> Iterator[Chunk]:
    """The chunks that Rerun's reader makes of a log or of its copy. Raises LogError if it refuses the log, perhaps
    for an invalid schema."""
    try:
        yield from reader.stream()
    except (RuntimeError, ValueError) as error:
        raise LogError(f"{log.path}: Rerun cannot show it ({brief(str(error))})") from None


def _summary(log: Log, drawn: Collection[str]) -> Iterator[Chunk]:
    """The chunks that Rerun's reader makes of a finished log's metadata and summary; opening the log has compared
    the summary's CRC. The time range makes Rerun skip all chunks of the log."""
    reader = McapReader(
        local_path(log.path),
        decoders=_OF_SUMMARY,
        exclude_topic_regex=_exactly(drawn),
        start_time_ns=LAST_TIME_NS - 1,
        end_time_ns=LAST_TIME_NS,
    )
    yield from _read_by_rerun(log, reader)


def _others(log: Log, left_out: Collection[str]) -> Iterator[Chunk]:
    """The chunks that Rerun's reader makes of attachments and of all topics except `left_out`."""
    topics = {channel.topic for channel in log.channels.values()}.difference(left_out)
    if not topics and not log.attachments:
        return
    with tempfile.TemporaryDirectory(prefix="bc-play-") as folder:
        copy = Path(folder) / log.path.name
        with LogWriter(copy, None) as writer:
            for offset in log.attachments:
                writer.copy_attachment(log.attachment(offset))
            for chunk in _chunks_with(log, topics):
                for schema, channel, message in log.messages_of(chunk):
                    if channel.topic in topics:
                        writer.copy(schema, channel, message, message.sequence)
        yield from _read_by_rerun(log, McapReader(copy, decoders=_NOT_OF_SUMMARY))


def _pictures(log: Log, topics: Collection[str], clock: Clock, skipped: Skipped, every: int) -> Iterator[Chunk]:
    """Chunks of pictures in the order of the file, with several pictures of a topic each."""
    waiting: dict[str, list[tuple[int, CompressedImage]]] = {}
    waiting_bytes = 0
    for chunk in _chunks_with(log, topics):
        try:
            messages = list(log.messages_of(chunk))
        except LogError:
            _add_damaged(log, topics, chunk, skipped)
            continue
        for _, channel, message in messages:
            if channel.topic not in topics:
                continue
            if message.sequence % every and message.log_time != log.time_range_ns[1]:
                continue
            try:
                picture = CompressedImage.FromString(message.data)
            except DecodeError:
                skipped.add("messages that cannot be decoded", f"{channel.topic} row {message.sequence}")
                continue
            waiting.setdefault(channel.topic, []).append((message.log_time, picture))
            waiting_bytes += len(picture.data)
        if waiting_bytes >= _SENT_BYTES:
            yield from _columns(waiting, clock)
            waiting, waiting_bytes = {}, 0
    yield from _columns(waiting, clock)


def _columns(by_topic: Mapping[str, Sequence[tuple[int, CompressedImage]]], clock: Clock) -> Iterator[Chunk]:
    for topic, timed in by_topic.items():
        times, pictures = zip(*timed, strict=True)
        yield Chunk.from_columns(
            rr.new_entity_path(topic.strip("/").split("/")),
            clock(np.array(times, np.int64)),
            picture_columns([picture.data for picture in pictures], [picture.format for picture in pictures]),
        )


def _add_damaged(log: Log, topics: Collection[str], chunk: LogChunk, skipped: Skipped) -> None:
    """Add the pictures in a damaged chunk to `skipped`, by the log's index of messages."""
    reason = damaged_pictures(log.path)
    for topic in topics:
        pictures = log.pictures(topic)
        is_inside = (pictures.offset >= chunk.start) & (pictures.offset < chunk.end)
        for row in pictures.sequence[is_inside].tolist():
            skipped.add(reason, f"{topic} row {row}")


def _chunks_with(log: Log, topics: Collection[str]) -> list[LogChunk]:
    """The chunks with a message on one of these topics, and those whose channels the summary does not list."""
    numbers = {number for number, channel in log.channels.items() if channel.topic in topics}
    return [chunk for chunk in log.chunks if chunk.channels is None or chunk.channels & numbers]


def _exactly(topics: Collection[str]) -> list[str]:
    return [f"^{re.escape(topic)}$" for topic in topics]


def picture_columns(encoded: Sequence[bytes], formats: Sequence[str]) -> rr.ComponentColumnList:
    """Columns with one picture a row, byte for byte; `formats` are "jpeg", "png" and so on. The pictures have
    Rerun's default coordinate frame of their entity."""
    media_types = [f"image/{name or 'jpeg'}" for name in formats]
    return rr.EncodedImage.columns(blob=_blobs(encoded), media_type=media_types)


def _blobs(encoded: Sequence[bytes]) -> pa.Array:
    """Bytes in Rerun's storage format; Rerun itself would convert them one by one."""
    ends = np.cumsum([0, *map(len, encoded)])
    values = pa.Array.from_buffers(pa.uint8(), int(ends[-1]), [None, pa.py_buffer(b"".join(encoded))])
    return pa.ListArray.from_arrays(pa.array(ends, pa.int32()), values, type=_BLOB)
