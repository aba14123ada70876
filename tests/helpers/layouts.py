"""Logs of both layouts: as they are written now, and as versions did that had no chunks of pictures alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType

from tests.helpers.plain_mcap import CopiedTopics, plain_writer

CHUNK_BYTES = 256 * 1024
Found = tuple[Schema | None, Channel, Message]
Layout = Callable[[Path], Path]
"""Takes a log that was just written, and gives it its layout."""


def two_kinds(path: Path) -> Path:
    """Pictures in chunks of their own, and everything else in others: as it was written."""
    return path


def mixed(path: Path, chunk_bytes: int = CHUNK_BYTES) -> Path:
    """As earlier versions wrote it."""
    written = write_as_before(path, path.with_name(f"{path.name}.mixed"), chunk_bytes)
    written.replace(path)
    return path


def write_as_before(log: Path, path: Path, chunk_bytes: int = CHUNK_BYTES, *, with_metadata: bool = True) -> Path:
    """The messages and metadata of `log`, row by row in chunks that mix all topics, by mcap's own writer."""
    options = {"chunk_size": chunk_bytes, "compression": CompressionType.NONE, "enable_data_crcs": True}
    with log.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        header = reader.get_header()
        metadata = list(reader.iter_metadata()) if with_metadata else []
        with plain_writer(path, header.profile, header.library, **options) as writer:
            for record in metadata[:1]:
                writer.add_metadata(record.name, record.metadata)
            topics = CopiedTopics(writer)
            for message in _row_by_row(list(reader.iter_messages(log_time_order=False))):
                topics.add(*message)
            for record in metadata[1:]:
                writer.add_metadata(record.name, record.metadata)
    return path


def _row_by_row(messages: list[Found]) -> list[Found]:
    """In the order in which they were recorded: each row's cameras, its vehicle state, its crop, the rest of it.
    Rows are numbered in that order; events have no number, and stay among the messages that are no pictures."""
    pictures = deque(each for each in messages if is_of_pictures(each[1].topic))
    ordered: list[Found] = []
    for found in messages:
        _, channel, message = found
        if is_of_pictures(channel.topic):
            continue
        its_crop: list[Found] = []
        while pictures and channel.topic != "/events" and pictures[0][2].sequence <= message.sequence:
            picture = pictures.popleft()
            is_its_crop = picture[1].topic == "/pilot/input" and picture[2].sequence == message.sequence
            (its_crop if is_its_crop else ordered).append(picture)
        ordered += [found, *its_crop]
    return [*ordered, *pictures]


def is_of_pictures(topic: str) -> bool:
    return topic.startswith("/camera/") or topic == "/pilot/input"
