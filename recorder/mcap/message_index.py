"""The index of a log's messages and pictures, made in one pass over the file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from recorder.mcap.compressed_image import image_data
from recorder.mcap.mcap_file import MESSAGE, RECORD, Chunk, McapFile
from recorder.mcap.scan import Structure

if TYPE_CHECKING:
    from google.protobuf.message import Message

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
Track = Callable[[Iterable[Read], int], Iterable[Read]]  # shows the progress while so many chunks are read

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
    file: McapFile, structure: Structure, chunks: Sequence[Chunk], track: Track
) -> NDArray[np.void]:
    """One ENTRY for each message in these chunks, in order. Raises LogError for a damaged chunk, or a time above
    LAST_TIME_NS."""
    parts, count, images = [], 0, sorted(structure.image_channels)
    for chunk, records in track(file.read_chunks(chunks), len(chunks)):
        parts.append(_in_chunk(file, chunk, records, images))
        count += len(parts[-1])
        file.check_count(count)
    table = np.concatenate(parts) if parts else np.empty(0, ENTRY)
    if (table["log_time_ns"] > LAST_TIME_NS).any():
        raise file.damaged(f"a message of the time {table['log_time_ns'].max()} ns")
    return table


def _in_chunk(file: McapFile, chunk: Chunk, records: bytes, images: Sequence[int]) -> NDArray[np.void]:
    """One ENTRY for each message in a chunk. `images`: channels of pictures."""
    starts = np.array(file.parts(records).messages, np.int64)
    table = np.empty(len(starts), ENTRY)
    if not len(starts):
        return table
    base = 0 if chunk.compression else file.records_at(chunk)
    # all messages' heads at once: a tuple for each would take 300 bytes
    heads = sliding_window_view(np.frombuffer(records, np.uint8), MESSAGE.size)[starts].view(_HEAD)[:, 0]
    for name in ("channel", "sequence", "log_time_ns"):
        table[name] = heads[name]
    table["offset"] = starts + base + MESSAGE.size
    table["length"] = heads["length"].astype(np.int64) - (MESSAGE.size - RECORD.size)
    table["picture"], table["picture_length"] = -1, 0
    table["chunk"] = chunk.start if chunk.compression else UNCOMPRESSED
    for at in np.flatnonzero(np.isin(table["channel"], images)).tolist():
        picture, length = image_data(records, int(starts[at]) + MESSAGE.size, int(table["length"][at]))
        if picture >= 0:
            table["picture"][at], table["picture_length"][at] = picture + base, length
    return table


def decode_numbers(
    data: bytes, starts: NDArray[np.int64], ends: NDArray[np.int64], kind: type[Message], names: Sequence[str]
) -> NDArray[np.float64]:
    """The fields `names` of N serialised messages of a type: an array (len(names), N). Message i is
    data[starts[i]:ends[i]]. A missing `optional` field is NaN. A field of a field is named "pose.position.x".
    Raises DecodeError as Protobuf does."""
    fields: list[Any] = list(kind.DESCRIPTOR.fields)
    lacking = {field.name for field in fields if field.has_presence and field.message_type is None}
    places = zip(starts.tolist(), ends.tolist(), strict=True)
    messages = [kind.FromString(data[start:end]) for start, end in places]
    values = np.empty((len(names), len(messages)))
    for row, name in zip(values, names, strict=True):
        row[:] = list(map(attrgetter(name), messages))
        if name in lacking:
            row[[not message.HasField(name) for message in messages]] = np.nan
    return values


def known_values(numbers: NDArray[np.float64], count: int) -> NDArray[np.int8]:
    """The values (N,) of an enum with `count` of them: 0, unknown, for those of a later version."""
    return np.where((numbers >= 0) & (numbers < count), numbers, 0).astype(np.int8)
