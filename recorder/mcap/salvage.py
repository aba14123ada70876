"""Finding what is whole in a damaged file, wherever it lies, for a recovery.

Readers take a chunk only where the summary, or the record before it, has one, and with a sound header.
Here chunks are found too that lie elsewhere, or whose header is damaged, if only the CRC of their records holds.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final

from mcap.opcode import Opcode

from recorder.errors import LogError
from recorder.mcap.compression import NOT_UNPACKED, unpack
from recorder.mcap.mcap_file import CHUNK_HEADER, MAGIC, MAX_CHUNK_BYTES, RECORD, Chunk, McapFile
from recorder.mcap.scan import Structure, add_definitions, add_record, next_chunk, search_budget

_COMPRESSIONS: Final = (b"", b"zstd", b"lz4")
_BESIDE_CHUNKS: Final = (
    Opcode.HEADER,
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.MESSAGE_INDEX,
    Opcode.METADATA,
    Opcode.ATTACHMENT,
)
_LENGTH: Final = struct.Struct("<I")  # of the compression's name
_SIZE: Final = struct.Struct("<Q")  # of what is stored
_LONGEST_HEADER: Final = CHUNK_HEADER.size + _LENGTH.size + max(map(len, _COMPRESSIONS)) + _SIZE.size


def salvage(file: McapFile, found: Structure) -> None:
    """Put every whole chunk of the file into `found`, and into its `lost` the stretches without one."""
    if found.problem:  # it was walked through: its chunks are whole
        stretches, indexed_ends = found.lost, dict[int, int]()
    else:
        stretches, indexed_ends = _beside_the_whole(file, found)
    found.lost = []
    indexed = found.metadata_at, found.attachments_at
    if indexed_ends:
        found.metadata_at, found.attachments_at = [], []  # they may have moved as well
    search = _Search(file, found, indexed_ends)
    for start, end in stretches:
        search.through(start, end)
    found.chunks.sort(key=lambda chunk: chunk.start)
    found.metadata_at = _all_of(found.metadata_at, indexed[0])
    found.attachments_at = _all_of(found.attachments_at, indexed[1])


def _all_of(found: list[int], indexed: list[int]) -> list[int]:
    """Offsets of records: those found, and where these are fewer than the indexed ones, those too."""
    return sorted({*found} if len({*found}) >= len(indexed) else {*found, *indexed})


def _beside_the_whole(file: McapFile, found: Structure) -> tuple[list[tuple[int, int]], dict[int, int]]:
    """Leave in `found` the chunks that are where the summary has them. If not all are, they may lie anywhere else:
    the stretches between the others, and where each that is not there would begin and end."""
    whole, indexed_ends = list[Chunk](), dict[int, int]()
    for chunk in found.chunks:
        try:
            file.parts(file.records(chunk))
        except LogError:
            indexed_ends[chunk.start] = chunk.end
        else:
            whole.append(chunk)
    if not indexed_ends:
        return [], {}
    found.chunks = whole
    starts = [len(MAGIC), *(chunk.end for chunk in whole)]
    ends = [*(chunk.start for chunk in whole), found.data_end]
    return list(zip(starts, ends, strict=True)), indexed_ends


class _Search:
    """Adds to `found` what is whole in stretches of the file, and what is lost in them."""

    def __init__(self, file: McapFile, found: Structure, indexed_ends: dict[int, int]) -> None:
        self._file = file
        self._found = found
        self._indexed_ends = indexed_ends  # by start, of chunks that are not whole there
        self._budget = search_budget(file)

    def through(self, start: int, end: int) -> None:
        start = self._behind_records(start, end)
        while start < end:
            chunk = self._chunk_at(start, end)
            if chunk is not None:
                self._found.chunks.append(chunk)
                start = self._behind_records(chunk.end, end)
                continue
            following = min(next_chunk(self._file, start + 1), end) if self._budget > 0 else end
            self._lose(start, following)
            start = following

    def _lose(self, start: int, end: int) -> None:
        """Note that nothing is whole from `start` to `end`, but what lies behind a chunk's indexed end."""
        if self._found.lost and self._found.lost[-1][1] == start:
            start = self._found.lost.pop()[0]
        indexed_end = self._indexed_ends.get(start, end)
        if start < indexed_end < end and self._behind_records(indexed_end, end) == end:
            end = indexed_end
        self._found.lost.append((start, end))

    def _chunk_at(self, start: int, end: int) -> Chunk | None:
        """A whole chunk that begins at `start` and ends within `end`."""
        for chunk in self._guesses(start, end):
            try:
                add_definitions(self._file, self._file.records(chunk), self._found)
            except LogError:
                if self._budget <= 0:
                    break
            else:
                return chunk
        return None

    def _guesses(self, start: int, end: int) -> Iterator[Chunk]:
        """Chunks that may begin there: a header has its chunk's length in several ways; one may be damaged."""
        head = self._file.read(start, min(_LONGEST_HEADER, end - start))
        for name in _COMPRESSIONS:
            stored_at = CHUNK_HEADER.size + _LENGTH.size + len(name) + _SIZE.size
            if len(head) < stored_at:
                break
            _, stated_length, _, _, stated_size, crc = CHUNK_HEADER.unpack_from(head)
            (stored_size,) = _SIZE.unpack_from(head, stored_at - _SIZE.size)
            indexed_end = min(self._indexed_ends.get(start, end), end)
            lengths = [RECORD.size + stated_length, stored_at + stored_size, indexed_end - start]
            if not name:
                lengths.append(stored_at + stated_size)
            for length in dict.fromkeys(lengths):
                if not stored_at <= length <= min(end - start, MAX_CHUNK_BYTES):
                    continue
                for size in self._sizes(start, length, stored_at, name, stated_size):
                    self._budget -= length + (size if name else 0)
                    mended = _mended(head, length, name, size, length - stored_at)
                    if head.startswith(mended):
                        yield Chunk(start, start + length, name.decode())
                    elif crc:  # where there is none, anything would do
                        yield Chunk(start, start + length, name.decode(), mended=mended)

    def _sizes(self, start: int, length: int, stored_at: int, name: bytes, stated: int) -> Iterator[int]:
        """Sizes that the chunk may unpack to: the stated one, and that which it does unpack to."""
        if not name:
            yield length - stored_at
            return
        if stated <= MAX_CHUNK_BYTES:
            yield stated
        stored = self._file.read(start + stored_at, length - stored_at)
        try:
            found = len(unpack(stored, name, MAX_CHUNK_BYTES))
        except NOT_UNPACKED:
            return
        if found != stated:
            yield found

    def _behind_records(self, start: int, end: int) -> int:
        """The end of the sound records that lie before the next chunk: indexes, metadata, the file's header."""
        while end - start >= RECORD.size:
            opcode, length = RECORD.unpack(self._file.read(start, RECORD.size))
            following = start + RECORD.size + length
            if opcode not in _BESIDE_CHUNKS or following > end:
                break
            try:
                add_record(self._file, opcode, start, following, self._found)
            except LogError:
                break
            start = following
        return start


def _mended(head: bytes, length: int, compression: bytes, size: int, stored_size: int) -> bytes:
    """The header of a chunk, with times and CRC as they are."""
    return b"".join(
        (
            RECORD.pack(Opcode.CHUNK, length - RECORD.size),
            head[9:25],
            _SIZE.pack(size),
            head[33:37],
            _LENGTH.pack(len(compression)),
            compression,
            _SIZE.pack(stored_size),
        )
    )
