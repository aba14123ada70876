"""The index of a log's messages and pictures, made in one pass over the file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from recorder.mcap.compressed_image import image_data
from recorder.mcap.mcap_file import MESSAGE, RECORD, Chunk, McapFile
from recorder.mcap.scan import Structure

UNCOMPRESSED: Final = -1  # instead of a chunk's offset: the bytes are in the file itself
LAST_TIME_NS: Final = 2**63 - 1  # MCAP's times are unsigned; those of files, tables and NumPy are signed

ENTRY: Final = np.dtype(
    [
        ("channel", np.uint16),
        ("sequence", np.uint32),
        ("log_time_ns", np.uint64),
        ("offset", np.int64),  # of the message's content, in the file or in its unpacked chunk
        ("length", np.int64),
        ("picture", np.int64),  # the same for a CompressedImage's data; -1 for other messages
        ("picture_length", np.int64),
        ("chunk", np.int64),  # start of the message's compressed chunk, or UNCOMPRESSED
    ]
)

Read = tuple[Chunk, bytes]  # a chunk and its records

_HEAD: Final = np.dtype(
    [
        ("opcode", np.uint8),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time_ns", "<u8"),
        ("publish_time_ns", "<u8"),
    ]
)  # as MESSAGE, without gaps


def index_messages(
    file: McapFile,
    structure: Structure,
    chunks: Sequence[Chunk],
    track: Callable[[Iterable[Read]], Iterable[Read]] = lambda read: read,
) -> NDArray[np.void]:
    """One ENTRY for each message in these chunks, in order. `track` shows the progress.

    Raises LogError for a damaged chunk, or a time above LAST_TIME_NS.
    """
    images = np.array(sorted(structure.image_channels), np.uint16)
    parts, count = [], 0
    for chunk, records in track(file.read_chunks(chunks)):
        parts.append(_in_chunk(file, chunk, records, images))
        count += len(parts[-1])
        file.check_count(count)
    table = np.concatenate(parts) if parts else np.empty(0, ENTRY)
    if (table["log_time_ns"] > LAST_TIME_NS).any():
        raise file.damaged(f"a message of the time {table['log_time_ns'].max()} ns")
    return table


def _in_chunk(file: McapFile, chunk: Chunk, records: bytes, images: NDArray[np.uint16]) -> NDArray[np.void]:
    """One ENTRY for each message of a chunk's records. `images`: channels of pictures."""
    starts = np.array(file.parts(records).messages, np.int64)
    base = 0 if chunk.compression else file.records_at(chunk)
    table = np.empty(len(starts), ENTRY)
    if not len(starts):
        return table
    # all messages' heads at once: a tuple for each would take 300 bytes
    heads = sliding_window_view(np.frombuffer(records, np.uint8), MESSAGE.size)[starts].view(_HEAD)[:, 0]
    for name in ("channel", "sequence", "log_time_ns"):
        table[name] = heads[name]
    table["offset"] = starts + (base + MESSAGE.size)
    table["length"] = heads["length"].astype(np.int64) - (MESSAGE.size - RECORD.size)
    table["picture"], table["picture_length"] = -1, 0
    table["chunk"] = chunk.start if chunk.compression else UNCOMPRESSED
    for at in np.flatnonzero(np.isin(table["channel"], images)).tolist():
        picture, length = image_data(records, int(table["offset"][at]) - base, int(table["length"][at]))
        if picture >= 0:
            table["picture"][at], table["picture_length"][at] = picture + base, length
    return table
