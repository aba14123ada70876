"""Where every message of a log lies, and where the pictures lie within theirs: one pass over the file."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from recorder import compressed_image
from recorder.chunks import Chunk, McapFile
from recorder.compressed_image import image_data
from recorder.structure import Structure

UNCOMPRESSED: Final = -1
"""In the place of a chunk's offset: the bytes lie in the file as they are."""
LAST_TIME_NS: Final = 2**63 - 1
"""MCAP's times are unsigned, but those of files, tables and NumPy are not."""

PLACE: Final = np.dtype(
    [
        ("channel", np.uint16),
        ("sequence", np.uint32),
        ("log_time_ns", np.uint64),
        ("offset", np.int64),  # of the message's content, from the start of the file or within its chunk unpacked
        ("length", np.int64),
        ("picture", np.int64),  # as offset, of a CompressedImage's data; -1 where the message is none
        ("picture_length", np.int64),
        ("chunk", np.int64),  # where the compressed chunk begins that holds it, or UNCOMPRESSED
    ]
)


def find_places(file: McapFile, structure: Structure) -> NDArray[np.void]:
    """One PLACE for each message, in the order of the file.

    Raises LogError for a damaged chunk, or a time that no clock of ours can hold.
    """
    images = _image_channels(structure)
    parts = [_in_chunk(file, chunk, images) for chunk in structure.chunks]
    table = np.concatenate(parts) if parts else np.empty(0, PLACE)
    if (table["log_time_ns"] > LAST_TIME_NS).any():
        raise file.damaged(f"a message of the time {table['log_time_ns'].max()} ns")
    return table


def _in_chunk(file: McapFile, chunk: Chunk, images: frozenset[int]) -> NDArray[np.void]:
    records = file.records(chunk)
    base = 0 if chunk.compression else file.records_at(chunk)
    within = chunk.start if chunk.compression else UNCOMPRESSED
    rows = []
    for stored in file.messages(records):
        picture, picture_length = -1, 0
        if stored.channel in images:
            picture, picture_length = image_data(records, stored.offset, stored.length)
            picture += base if picture >= 0 else 0
        place = (stored.offset + base, stored.length, picture, picture_length, within)
        rows.append((stored.channel, stored.sequence, stored.log_time_ns, *place))
    return np.array(rows, PLACE)


def _image_channels(structure: Structure) -> frozenset[int]:
    schemas = {number for number, schema in structure.schemas.items() if schema.name == compressed_image.SCHEMA}
    return frozenset(number for number, channel in structure.channels.items() if channel.schema_id in schemas)
