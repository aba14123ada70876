"""The places of a log's pictures, kept at its end, so that readers of other messages skip the pictures.

They are in two kinds of attachments, each with a CRC:

- `bc.pictures`: a `PLACE` for each picture, in the order of writing. A long log has several.
- `bc.chunks`: a `CHUNK_CRC` for each chunk. It shows whether the lists describe this file: programs that rewrite a
  log copy attachments unchanged.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recorder.errors import LogError
from recorder.mcap.compressed_image import image_data
from recorder.mcap.mcap_file import (
    CHUNK_HEADER,
    MESSAGE,
    MIN_MESSAGE,
    OP_MESSAGE,
    RECORD,
    RECORDS_AT,
    Chunk,
    McapFile,
)
from recorder.mcap.message_index import ENTRY, LAST_TIME_NS, UNCOMPRESSED, Track, index_messages
from recorder.mcap.scan import Structure

PICTURES_ATTACHMENT: Final = "bc.pictures"
CHUNKS_ATTACHMENT: Final = "bc.chunks"
MEDIA_TYPE: Final = "application/octet-stream"
PLACES_AT_ONCE: Final = 1 << 20  # pictures in one attachment: 34 MB

PLACE: Final = np.dtype(
    [
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time_ns", "<u8"),
        ("chunk", "<u4"),  # number of the chunk, in the order of the file
        ("offset", "<u4"),  # of the message's content, from the start of the chunk's records
        ("length", "<u4"),
        ("picture", "<u4"),  # the same for the JPEG or PNG itself; NO_PICTURE if the message has none
        ("picture_length", "<u4"),
    ]
)
# used for each message: plain numbers are quicker
_RECORD_BYTES: Final = RECORD.size
_CONTENT_AT: Final = MESSAGE.size  # of a message, in its record
_PLACE: Final = struct.Struct("<HIQIIIII")  # as PLACE; quicker than an array for a few pictures
CHUNK_CRC: Final = np.dtype([("start", "<u8"), ("crc", "<u4")])  # offset in the file; CRC-32 of the records
NO_PICTURE: Final = 2**32 - 1

Attached = tuple[int, int, str, str, bytes]  # create time, log time, name, media type, content


@dataclass(frozen=True)
class Pictures:
    """Places of the pictures of one topic in a log; arrays of one length, in the order of writing."""

    sequence: NDArray[np.int64]
    log_time_ns: NDArray[np.int64]
    offset: NDArray[np.int64]  # of the JPEG or PNG itself, in the file or in its unpacked chunk
    length: NDArray[np.int64]  # bytes
    chunk: NDArray[np.int64]  # start of the picture's compressed chunk in the file, or UNCOMPRESSED


class PlacesWritten:
    """Collects the places of a file's pictures while it is written: 34 bytes a picture."""

    def __init__(self) -> None:
        self.channels: set[int] = set()  # of pictures
        self.count = 0  # pictures since `take_pictures`
        self._places = bytearray()
        self._chunks: list[tuple[int, int]] = []

    def add_chunk(self, start: int, record: bytes) -> None:
        *_, crc = CHUNK_HEADER.unpack_from(record)
        self._places += places_in(record, len(self._chunks), self.channels)
        self.count = len(self._places) // _PLACE.size
        self._chunks.append((start, crc))

    def take_pictures(self) -> Attached:
        content = bytes(self._places)
        self._places, self.count = bytearray(), 0
        return 0, 0, PICTURES_ATTACHMENT, MEDIA_TYPE, content

    def take_chunks(self) -> Attached:
        return 0, 0, CHUNKS_ATTACHMENT, MEDIA_TYPE, np.array(self._chunks, CHUNK_CRC).tobytes()


def places_in(record: bytes, number: int, channels: set[int]) -> bytes:
    """The PLACE of each picture in a sound chunk, from the chunk's `record`. `number` is the chunk's in the file;
    `channels` are those of pictures."""
    places, position, end = bytearray(), RECORDS_AT, len(record) if channels else 0
    while position < end:
        opcode, length = RECORD.unpack_from(record, position)
        if opcode == OP_MESSAGE:
            _, _, channel, sequence, log_time_ns, _ = MESSAGE.unpack_from(record, position)
            if channel in channels:
                at, size = position + _CONTENT_AT, length - MIN_MESSAGE
                picture, picture_size = image_data(record, at, size)
                picture = picture - RECORDS_AT if picture >= 0 else NO_PICTURE
                places += _PLACE.pack(
                    channel, sequence, log_time_ns, number, at - RECORDS_AT, size, picture, picture_size
                )
        position += _RECORD_BYTES + length
    return bytes(places)


def is_about_places(name: str) -> bool:
    """True for the attachments of this module. They describe one file, and are not copied into another."""
    return name in (PICTURES_ATTACHMENT, CHUNKS_ATTACHMENT)


def read_chunk_crcs(file: McapFile, structure: Structure) -> list[int] | None:
    """The CRC of each chunk, from the end of a log of ours; None without a list that describes this file."""
    content = _attached(file, structure, CHUNKS_ATTACHMENT, len(structure.chunks) * CHUNK_CRC.itemsize)
    if content is None:
        return None
    stored = np.frombuffer(content, CHUNK_CRC)
    if stored["start"].tolist() != [chunk.start for chunk in structure.chunks]:
        return None
    crcs: list[int] = stored["crc"].tolist()
    return crcs


def read_places(file: McapFile, structure: Structure) -> NDArray[np.void] | None:
    """An ENTRY for each message in the chunks of pictures, from the lists at the end of a log of ours.

    None if the lists are missing or do not fit the file's summary: then the whole file has to be read.
    """
    places = None if read_chunk_crcs(file, structure) is None else stored_places(file, structure)
    if places is None:
        return None
    if (places["chunk"] >= len(structure.chunks)).any() or (places["log_time_ns"] > LAST_TIME_NS).any():
        return None
    base = np.array([chunk.start for chunk in structure.chunks], np.int64)[places["chunk"]] + RECORDS_AT
    table = np.empty(len(places), ENTRY)
    for name in ("channel", "sequence", "log_time_ns", "length", "picture_length"):
        table[name] = places[name]
    table["offset"] = base + places["offset"]
    table["picture"] = np.where(places["picture"] == NO_PICTURE, -1, base + places["picture"])
    table["chunk"] = UNCOMPRESSED
    return table


def stored_places(file: McapFile, structure: Structure) -> NDArray[np.void] | None:
    """The stored PLACE of each picture, unchecked; None if their number is wrong or an attachment is damaged."""
    counts = {} if structure.statistics is None else structure.statistics.channel_message_counts
    count = sum(counts.get(number, 0) for number in structure.image_channels)
    content = _attached(file, structure, PICTURES_ATTACHMENT, count * PLACE.itemsize)
    return None if content is None else np.frombuffer(content, PLACE)


def is_of_pictures(chunk: Chunk, images: set[int]) -> bool:
    """True if, by the summary, a chunk is uncompressed and has only messages of the channels `images`."""
    return chunk.channels is not None and not chunk.compression and chunk.channels <= images


def _attached(file: McapFile, structure: Structure, name: str, size: int) -> bytes | None:
    """The joined contents of all attachments with this name; None if they are not `size` bytes together."""
    if not 0 < size <= file.size:
        return None
    parts, missing_bytes = [], size
    for offset in sorted(offset for offset, stored in structure.attachment_names.items() if stored == name):
        try:
            parts.append(file.attachment(offset).data)
        except LogError:
            return None
        missing_bytes -= len(parts[-1])
        if missing_bytes < 0:
            return None
    return None if missing_bytes else b"".join(parts)


class LogIndex:
    """An ENTRY for each message of a log. Raises LogError for a damaged log when it is read."""

    def __init__(
        self, file: McapFile, structure: Structure, track: Track, have_read: Callable[[Sequence[Chunk]], object]
    ) -> None:
        """`have_read` gets chunks when they were read: their CRCs match."""
        self._file = file
        self._structure = structure
        self._track = track
        self._have_read = have_read
        self._images = structure.image_channels
        self._lists_pictures = False

    def of_topic(self, topic: str) -> NDArray[np.void]:
        channels = {number for number, channel in self._structure.channels.items() if channel.topic == topic}
        needs_pictures = channels & self._images or not self._is_whole_beside_pictures
        index = self.all if needs_pictures else self._beside_pictures
        return index[np.isin(index["channel"], list(channels))]

    @cached_property
    def all(self) -> NDArray[np.void]:
        places = read_places(self._file, self._structure) if self._file.is_ours else None
        self._lists_pictures = places is not None
        if places is not None:
            return np.concatenate([self._beside_pictures, places])
        chunks = self._structure.chunks
        return self._beside_pictures if len(self._other_chunks) == len(chunks) else self._index_of(chunks)

    @property
    def is_mixed(self) -> bool:
        """True if other messages cannot be read without pictures, because the pictures' places are not listed."""
        return len(self.all) > 0 and len(self._images) > 0 and not self._lists_pictures

    @cached_property
    def _other_chunks(self) -> list[Chunk]:
        return [chunk for chunk in self._structure.chunks if not is_of_pictures(chunk, self._images)]

    @cached_property
    def _beside_pictures(self) -> NDArray[np.void]:
        return self._index_of(self._other_chunks)

    @cached_property
    def _is_whole_beside_pictures(self) -> bool:
        """True if all other messages are found without the chunks of pictures. A wrong summary may hide some in
        them."""
        if not self._file.is_ours or CHUNKS_ATTACHMENT not in self._structure.attachment_names.values():
            return False
        statistics = self._structure.statistics
        counts = {} if statistics is None else statistics.channel_message_counts
        count = sum(count for number, count in counts.items() if number not in self._images)
        return len(self._beside_pictures) == count

    def _index_of(self, chunks: Sequence[Chunk]) -> NDArray[np.void]:
        index = index_messages(self._file, self._structure, chunks, self._track)
        self._have_read(chunks)
        return index
