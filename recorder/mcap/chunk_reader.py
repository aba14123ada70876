"""Byte ranges of a log's chunks, from any thread, and only of chunks with a matching CRC."""

from __future__ import annotations

import bisect
import threading
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recorder.mcap.mcap_file import Chunk, McapFile
from recorder.mcap.message_index import UNCOMPRESSED

_CACHED_CHUNKS: Final = 8  # unpacked, about a megabyte each
_CACHED_BYTES: Final = 1 << 26  # together


class ChunkReader:
    """Reads from chunks of a file, and checks the CRC of each once. Keeps the last few chunks that were compressed
    or fetched from a store in memory."""

    def __init__(self, file: McapFile, chunks: Sequence[Chunk]) -> None:
        self._file = file
        self._chunks = chunks
        self._starts = [chunk.start for chunk in chunks]
        self._starts_and_none = np.array([*self._starts, -1], np.int64)
        self._is_verified = bytearray(len(chunks))
        self._unpacked: OrderedDict[int, bytes] = OrderedDict()
        self._lock = threading.Lock()

    def set_verified(self, chunks: Iterable[Chunk]) -> None:
        """Note that these chunks were read, and that their CRCs match."""
        for chunk in chunks:
            self._is_verified[bisect.bisect_left(self._starts, chunk.start)] = True

    def read(self, offset: int, length: int, chunk: int = UNCOMPRESSED) -> bytes:
        """`length` bytes from `offset`: in the file, or in the unpacked records of the chunk that begins at byte
        `chunk`. Raises LogError if they are in no chunk, or its CRC does not match."""
        if chunk != UNCOMPRESSED:
            data = self._unpacked_records(chunk)[offset : offset + length]
            if offset < 0 or len(data) != length:
                raise self._file.damaged(f"bytes {offset} to {offset + length} lie outside their chunk")
            return data
        if self._file.is_remote:  # one request, as for a single picture
            start, records = self.records_around(offset, length)
            return records[offset - start : offset - start + length]
        number = self._number_of(offset, length)
        if not self._is_verified[number]:
            self._file.records(self._chunks[number])
            self._is_verified[number] = True
        return self._file.read(offset, length)

    def chunks_of(self, offset: NDArray[np.int64], chunk: NDArray[np.int64]) -> NDArray[np.int64]:
        """The start of the chunk of each place (N,); -1 before the first chunk."""
        number = np.searchsorted(self._starts_and_none[:-1], offset, side="right") - 1
        return np.where(chunk == UNCOMPRESSED, self._starts_and_none[number], chunk)

    def records_around(self, offset: int, length: int, unpacked: int = UNCOMPRESSED) -> tuple[int, bytes]:
        """The records of the chunk that has these bytes, and their offset in the file; 0 for the records of the
        compressed chunk that begins at byte `unpacked`. Raises as `read`."""
        if unpacked != UNCOMPRESSED:
            self.read(offset, length, unpacked)
            return 0, self._unpacked_records(unpacked)
        number = self._number_of(offset, length)
        chunk = self._chunks[number]
        start = self._file.records_at(chunk)
        if self._file.is_remote:
            records = self._unpacked_records(chunk.start)
        elif self._is_verified[number]:
            records = self._file.read(start, chunk.end - start)
        else:
            records = self._file.records(chunk)
        self._is_verified[number] = True
        return start, records

    def _number_of(self, offset: int, length: int) -> int:
        number = bisect.bisect_right(self._starts, offset) - 1
        if number < 0 or offset + length > self._chunks[number].end:
            raise self._file.damaged(f"bytes {offset} to {offset + length} lie in no chunk")
        return number

    def _unpacked_records(self, start: int) -> bytes:
        records = self._unpacked.get(start)
        if records is None:
            number = bisect.bisect_left(self._starts, start)
            if number == len(self._chunks) or self._starts[number] != start:
                raise self._file.damaged(f"no chunk begins at byte {start:,}")
            records = self._file.records(self._chunks[number])
            with self._lock:
                self._unpacked[start] = records
                kept = list(self._unpacked.values())
                while len(kept) > _CACHED_CHUNKS or sum(map(len, kept)) > _CACHED_BYTES:
                    kept.pop(0)
                    self._unpacked.popitem(last=False)
        return records
