"""Where each picture of a log lies, kept at its end: what is in its other chunks is read without reading pictures.

Two attachments, which MCAP gives a CRC each. `bc.pictures`: a `PLACE` for each picture, in the order of writing; a
long log has several of them. `bc.chunks`: a `CHUNK_CRC` for each chunk, by which it is seen whether what is told
here is about this file: another program that writes a log anew copies attachments as they are.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from recorder.errors import LogError
from recorder.log.mcap_file import CHUNK_HEADER, RECORD, RECORDS_AT, Chunk, McapFile
from recorder.log.message_index import ENTRY, LAST_TIME_NS, UNCOMPRESSED, chunk_entries
from recorder.log.scan import Structure

PICTURES_ATTACHMENT: Final = "bc.pictures"
CHUNKS_ATTACHMENT: Final = "bc.chunks"
MEDIA_TYPE: Final = "application/octet-stream"
PLACES_AT_ONCE: Final = 1 << 20
"""Pictures that one attachment is about: 34 MB."""

PLACE: Final = np.dtype(
    [
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time_ns", "<u8"),
        ("chunk", "<u4"),  # number of the chunk, in the order of the file
        ("offset", "<u4"),  # of the message's content, from the start of the chunk's records
        ("length", "<u4"),
        ("picture", "<u4"),  # as offset, of the JPEG or PNG itself; NO_PICTURE where the message has none
        ("picture_length", "<u4"),
    ]
)
CHUNK_CRC: Final = np.dtype([("start", "<u8"), ("crc", "<u4")])  # offset in the file; CRC-32 of the records
NO_PICTURE: Final = 2**32 - 1

Attached = tuple[int, int, str, str, bytes]
"""Create time, log time, name, media type, content."""


class PlacesWritten:
    """Collects where the pictures of a file lie while it is written: 34 bytes a picture."""

    def __init__(self) -> None:
        self.channels: set[int] = set()  # those of pictures
        self._places: list[NDArray[np.void]] = []
        self._count = 0
        self._chunks: list[tuple[int, int]] = []

    def __len__(self) -> int:
        """Pictures that are not taken yet."""
        return self._count

    def add_chunk(self, start: int, record: bytes) -> None:
        """A chunk that begins at byte `start` of the file."""
        *_, crc = CHUNK_HEADER.unpack_from(record)
        places = places_in(record, len(self._chunks), self.channels)
        self._chunks.append((start, crc))
        if len(places):
            self._places.append(places)
            self._count += len(places)

    def take_pictures(self) -> Attached:
        """The attachment about the pictures that were not taken yet."""
        content = b"".join(part.tobytes() for part in self._places)
        self._places, self._count = [], 0
        return 0, 0, PICTURES_ATTACHMENT, MEDIA_TYPE, content

    def take_chunks(self) -> Attached:
        return 0, 0, CHUNKS_ATTACHMENT, MEDIA_TYPE, np.array(self._chunks, CHUNK_CRC).tobytes()


def places_in(record: bytes, number: int, channels: set[int]) -> NDArray[np.void]:
    """A PLACE for each picture in a sound chunk: its record, its number in the file, the channels of pictures."""
    if not channels:
        return np.empty(0, PLACE)
    records = memoryview(record)[RECORDS_AT:]
    images = np.fromiter(channels, np.uint16)
    table = chunk_entries(records, _message_starts(records), images)
    table = table[np.isin(table["channel"], images)]
    places = np.empty(len(table), PLACE)
    for name in PLACE.names or ():
        places[name] = table[name].astype(PLACE[name])  # -1, no picture, becomes NO_PICTURE
    places["chunk"] = number
    return places


def is_about_places(name: str) -> bool:
    """True for the attachments of this module, which are about one file, and never copied into another."""
    return name in (PICTURES_ATTACHMENT, CHUNKS_ATTACHMENT)


def read_chunk_crcs(file: McapFile, structure: Structure) -> list[int] | None:
    """The CRC of each chunk, as the end of a log of ours has them; None where nothing is told of this file."""
    content = _attached(file, structure, CHUNKS_ATTACHMENT)
    if content is None or len(content) != len(structure.chunks) * CHUNK_CRC.itemsize:
        return None
    stored = np.frombuffer(content, CHUNK_CRC)
    if stored["start"].tolist() != [chunk.start for chunk in structure.chunks]:
        return None
    crcs: list[int] = stored["crc"].tolist()
    return crcs


def read_places(file: McapFile, structure: Structure) -> NDArray[np.void] | None:
    """An ENTRY for each message in the chunks of pictures, as the end of a log of ours tells them.

    None where that is missing, or does not fit the file's summary: then only reading all of it tells.
    """
    places = stored_places(file, structure)
    if places is None or structure.statistics is None or read_chunk_crcs(file, structure) is None:
        return None
    is_picture_chunk = np.array([is_of_pictures(chunk, structure) for chunk in structure.chunks])
    if not np.array_equal(np.unique(places["chunk"]), np.flatnonzero(is_picture_chunk)):
        return None
    counted = dict(zip(*(each.tolist() for each in np.unique(places["channel"], return_counts=True)), strict=True))
    stored = structure.statistics.channel_message_counts
    if counted != {n: stored[n] for n in structure.image_channels if stored.get(n)}:
        return None
    starts = np.array([chunk.start for chunk in structure.chunks], np.int64)
    ends = np.array([chunk.end for chunk in structure.chunks], np.int64)
    base, end = starts[places["chunk"]] + RECORDS_AT, ends[places["chunk"]]
    table = np.empty(len(places), ENTRY)
    for name in ("channel", "sequence", "log_time_ns", "length", "picture_length"):
        table[name] = places[name]
    table["offset"] = base + places["offset"]
    table["picture"] = np.where(places["picture"] == NO_PICTURE, -1, base + places["picture"])
    table["chunk"] = UNCOMPRESSED
    is_inside = table["offset"] + table["length"] <= end
    is_inside &= (table["picture"] < 0) | (table["picture"] >= table["offset"])
    is_inside &= table["picture"] + table["picture_length"] <= table["offset"] + table["length"]
    is_in_order = (np.diff(table["offset"]) > 0).all()
    has_times = (table["log_time_ns"] <= LAST_TIME_NS).all()
    return table if is_inside.all() and is_in_order and has_times else None


def stored_places(file: McapFile, structure: Structure) -> NDArray[np.void] | None:
    """The PLACE of each picture as they are stored, whether or not that is true; None where they are not."""
    content = _attached(file, structure, PICTURES_ATTACHMENT)
    if content is None or len(content) % PLACE.itemsize:
        return None
    return np.frombuffer(content, PLACE)


def is_of_pictures(chunk: Chunk, structure: Structure) -> bool:
    """True for an uncompressed chunk that has, by the summary, pictures and nothing else."""
    return chunk.channels is not None and not chunk.compression and chunk.channels <= structure.image_channels


def _attached(file: McapFile, structure: Structure, name: str) -> bytes | None:
    """The contents of the attachments of this name, one after the other."""
    found = [at for at, its_name in sorted(structure.attachment_names.items()) if its_name == name]
    try:
        return b"".join(file.attachment(at).data for at in found) if found else None
    except LogError:
        return None


def _message_starts(records: memoryview) -> NDArray[np.int64]:
    """Where the messages begin among the records of a chunk that has just been made."""
    starts, position = [], 0
    while position < len(records):
        opcode, length = RECORD.unpack_from(records, position)
        if opcode == Opcode.MESSAGE:
            starts.append(position)
        position += RECORD.size + length
    return np.array(starts, np.int64)
