"""What is whole in a damaged file wherever it lies: what recovering takes.

Readers take a chunk only where the summary, or the record before it, says that one is, and with a sound header.
Here chunks are found too that lie elsewhere, or whose header is damaged, if only the CRC of their records holds.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final

from mcap.opcode import Opcode

from recorder.chunks import CHUNK_HEADER, MAX_CHUNK_BYTES, NOT_UNPACKED, RECORD, Chunk, McapFile, unpack
from recorder.errors import LogError
from recorder.structure import Structure, definitions, next_chunk, search_budget, take

_COMPRESSIONS: Final = (b"", b"zstd", b"lz4")
_BETWEEN_CHUNKS: Final = (Opcode.MESSAGE_INDEX, Opcode.METADATA, Opcode.ATTACHMENT)
_LENGTH: Final = struct.Struct("<I")  # of the compression's name
_SIZE: Final = struct.Struct("<Q")  # of what is stored
_LONGEST_HEADER: Final = CHUNK_HEADER.size + _LENGTH.size + max(map(len, _COMPRESSIONS)) + _SIZE.size


def salvage(file: McapFile, found: Structure) -> None:
    """Make `found` tell every chunk of the file that is whole; its `lost` are then where nothing is."""
    if found.problem:  # it was walked through: its chunks are whole
        damaged = found.lost
    else:
        found.chunks, damaged = _by_summary(file, found)
    found.lost = []
    search = _Search(file, found)
    for start, end in damaged:
        search.through(start, end)
    found.chunks.sort(key=lambda chunk: chunk.start)
    found.metadata_at, found.attachments_at = sorted({*found.metadata_at}), sorted({*found.attachments_at})


def _by_summary(file: McapFile, structure: Structure) -> tuple[list[Chunk], list[tuple[int, int]]]:
    """The whole chunks, and the stretches of neighbouring others: what has moved ends where no other did."""
    whole, damaged = list[Chunk](), list[tuple[int, int]]()
    is_in_stretch = False
    for chunk in structure.chunks:
        try:
            file.parts(file.records(chunk))
        except LogError:
            start = damaged.pop()[0] if is_in_stretch else chunk.start
            damaged.append((start, chunk.end))
            is_in_stretch = True
        else:
            whole.append(chunk)
            is_in_stretch = False
    return whole, damaged


class _Search:
    """Adds to `found` what is whole in stretches of the file, and what is lost in them."""

    def __init__(self, file: McapFile, found: Structure) -> None:
        self._file = file
        self._found = found
        self._budget = search_budget(file)

    def through(self, start: int, end: int) -> None:
        while start < end:
            chunk = self._chunk_at(start, end)
            if chunk is not None:
                self._found.chunks.append(chunk)
                start = self._behind_records(chunk.end, end)
                continue
            following = min(next_chunk(self._file, start + 1), end) if self._budget > 0 else end
            if self._found.lost and self._found.lost[-1][1] == start:
                start = self._found.lost.pop()[0]
            self._found.lost.append((start, following))
            start = following

    def _chunk_at(self, start: int, end: int) -> Chunk | None:
        """A whole chunk that begins at `start` and ends within `end`."""
        for chunk in self._guesses(start, end):
            try:
                definitions(self._file, self._file.records(chunk), self._found)
            except LogError:
                if self._budget <= 0:
                    break
            else:
                return chunk
        return None

    def _guesses(self, start: int, end: int) -> Iterator[Chunk]:
        """What may begin there: a header says its chunk's length in several ways, of which one may be damaged."""
        head = self._file.read(start, min(_LONGEST_HEADER, end - start))
        for name in _COMPRESSIONS:
            stored_at = CHUNK_HEADER.size + _LENGTH.size + len(name) + _SIZE.size
            if len(head) < stored_at:
                break
            _, told_length, _, _, told_size, crc = CHUNK_HEADER.unpack_from(head)
            (stored_size,) = _SIZE.unpack_from(head, stored_at - _SIZE.size)
            lengths = [RECORD.size + told_length, stored_at + stored_size, end - start]
            if not name:
                lengths.append(stored_at + told_size)
            for length in dict.fromkeys(lengths):
                if not stored_at <= length <= min(end - start, MAX_CHUNK_BYTES):
                    continue
                for size in self._sizes(start, length, stored_at, name, told_size):
                    self._budget -= length + (size if name else 0)
                    mended = _mended(head, length, name, size, length - stored_at)
                    if head.startswith(mended):
                        yield Chunk(start, start + length, name.decode())
                    elif crc:  # where there is none, anything would do
                        yield Chunk(start, start + length, name.decode(), mended=mended)

    def _sizes(self, start: int, length: int, stored_at: int, name: bytes, told: int) -> Iterator[int]:
        """What the chunk may unpack to: what it tells, and what it does."""
        if not name:
            yield length - stored_at
            return
        if told <= MAX_CHUNK_BYTES:
            yield told
        stored = self._file.read(start + stored_at, length - stored_at)
        try:
            found = len(unpack(stored, name, MAX_CHUNK_BYTES))
        except NOT_UNPACKED:
            return
        if found != told:
            yield found

    def _behind_records(self, start: int, end: int) -> int:
        """Where what follows a chunk ends: its indexes, and metadata before the next one."""
        while end - start >= RECORD.size:
            opcode, length = RECORD.unpack(self._file.read(start, RECORD.size))
            following = start + RECORD.size + length
            if opcode not in _BETWEEN_CHUNKS or following > end:
                break
            try:
                take(self._file, opcode, start, following, self._found)
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
