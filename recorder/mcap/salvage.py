"""Finds the whole chunks of a damaged file, for a recovery.

Readers accept a chunk only with a sound header, at the place that the summary or the previous record gives. A
salvage also finds chunks with a damaged header, and chunks elsewhere, if the CRC of their records matches.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final

from mcap.opcode import Opcode

from recorder.errors import LogError
from recorder.mcap.mcap_file import CHUNK_HEADER, MAX_CHUNK_BYTES, NOT_UNPACKED, RECORD, Chunk, McapFile, unpack
from recorder.mcap.scan import Structure, add_definitions, add_record, next_chunk, search_budget, walk

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


def salvage(file: McapFile, structure: Structure) -> None:
    """Set the structure's chunks to those with a matching CRC, in the file's order, also if their header is
    damaged. Set its `lost` to the other stretches."""
    stretches = structure.lost if structure.problem else _drop_damaged(file, structure)
    structure.lost = []
    search = _Search(file, structure)
    for start, end in stretches:
        search.through(start, end)
    if structure.lost and not structure.problem:  # chunks may have moved
        walked = walk(file, structure.data_end)
        starts = {chunk.start for chunk in structure.chunks}
        if moved := [chunk for chunk in walked.chunks if chunk.start not in starts]:
            structure.chunks += moved
            structure.lost = walked.lost
            structure.metadata_at, structure.attachments_at = walked.metadata_at, walked.attachments_at
    structure.chunks.sort(key=lambda chunk: chunk.start)


def _drop_damaged(file: McapFile, structure: Structure) -> list[tuple[int, int]]:
    """Drop the chunks that are damaged at their place in the summary; returns these places."""
    whole, damaged = list[Chunk](), list[tuple[int, int]]()
    for chunk in structure.chunks:
        try:
            file.parts(file.records(chunk))
        except LogError:
            damaged.append((chunk.start, chunk.end))
        else:
            whole.append(chunk)
    structure.chunks = whole
    return damaged


class _Search:
    """Searches stretches of the file, and adds whole chunks and lost bytes to the structure."""

    def __init__(self, file: McapFile, structure: Structure) -> None:
        self._file = file
        self._structure = structure
        self._budget = search_budget(file)

    def through(self, start: int, end: int) -> None:
        start = self._behind_records(start, end)
        while start < end:
            chunk = self._chunk_at(start, end)
            if chunk is not None:
                self._structure.chunks.append(chunk)
                start = self._behind_records(chunk.end, end)
                continue
            following = min(next_chunk(self._file, start + 1), end) if self._budget > 0 else end
            if self._structure.lost and self._structure.lost[-1][1] == start:
                start = self._structure.lost.pop()[0]
            self._structure.lost.append((start, following))
            start = following

    def _chunk_at(self, start: int, end: int) -> Chunk | None:
        for chunk in self._guesses(start, end):
            try:
                add_definitions(self._file, self._file.records(chunk), self._structure)
            except LogError:
                if self._budget <= 0:
                    break
            else:
                return chunk
        return None

    def _guesses(self, start: int, end: int) -> Iterator[Chunk]:
        """Chunks that may begin at `start`. A header has its chunk's length in several ways; one may be
        damaged."""
        head = self._file.read(start, min(_LONGEST_HEADER, end - start))
        for name in _COMPRESSIONS:
            stored_at = CHUNK_HEADER.size + _LENGTH.size + len(name) + _SIZE.size
            if len(head) < stored_at:
                break
            _, stated_length, _, _, stated_size, crc = CHUNK_HEADER.unpack_from(head)
            (stored_size,) = _SIZE.unpack_from(head, stored_at - _SIZE.size)
            lengths = [RECORD.size + stated_length, stored_at + stored_size, end - start]
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
                    elif crc:  # without one, any bytes would match
                        yield Chunk(start, start + length, name.decode(), mended=mended)

    def _sizes(self, start: int, length: int, stored_at: int, name: bytes, stated: int) -> Iterator[int]:
        """Possible unpacked sizes of the chunk: the stated size and the real one."""
        if not name:
            yield length - stored_at
            return
        if stated <= MAX_CHUNK_BYTES:
            yield stated
        stored = self._file.read(start + stored_at, length - stored_at)
        try:
            size = len(unpack(stored, name, MAX_CHUNK_BYTES))
        except NOT_UNPACKED:
            return
        if size != stated:
            yield size

    def _behind_records(self, start: int, end: int) -> int:
        """The end of the sound records from `start` to the next chunk: indexes, metadata, the file's header."""
        while end - start >= RECORD.size:
            opcode, length = RECORD.unpack(self._file.read(start, RECORD.size))
            following = start + RECORD.size + length
            if opcode not in _BESIDE_CHUNKS or following > end:
                break
            try:
                add_record(self._file, opcode, start, following, self._structure)
            except LogError:
                break
            start = following
        return start


def _mended(head: bytes, length: int, compression: bytes, size: int, stored_size: int) -> bytes:
    """The header of a chunk, with the times and the CRC of `head`."""
    _, _, first_ns, last_ns, _, crc = CHUNK_HEADER.unpack_from(head)
    fixed = CHUNK_HEADER.pack(Opcode.CHUNK, length - RECORD.size, first_ns, last_ns, size, crc)
    return fixed + _LENGTH.pack(len(compression)) + compression + _SIZE.pack(stored_size)
