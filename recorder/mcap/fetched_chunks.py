"""The chunks of a log in a store: on this machine's disk, on their way, or fetched when they are needed."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from mcap.opcode import Opcode

from common.closeable import Closeable
from recorder.errors import LogError
from recorder.mcap.chunk_cache import ChunkCache
from recorder.mcap.mcap_file import Chunk, McapFile

if TYPE_CHECKING:
    from concurrent.futures import Future

GAP_BYTES: Final = 1 << 16
"""Between two chunks that are fetched in one request: rows lie between those of pictures."""
MAX_BYTES: Final = 1 << 22  # of one request: as long on its way at 100 MB/s as its answer takes to begin
_KEPT_BYTES: Final = 1 << 26  # in memory, where the disk has no room


class FetchedChunks(Closeable):
    """Chunks by their numbers in the file. May be used from any thread."""

    def __init__(self, file: McapFile, chunks: Sequence[Chunk], cache: ChunkCache, fingerprint: str) -> None:
        self._file = file
        self._chunks = chunks
        self.max_bytes = cache.max_bytes  # of all logs that are kept on the disk
        self._cached = cache.open(fingerprint)
        self._lock = threading.Lock()
        self._is_verified = bytearray(len(chunks))  # by this process, as it is on the disk
        self._coming: dict[int, Future[bytes]] = {}
        self._kept: OrderedDict[int, bytes] = OrderedDict()
        self._damaged: dict[int, LogError] = {}

    def close(self) -> None:
        if self._cached is not None:
            self._cached.close()

    def read(self, number: int, offset: int, length: int) -> bytes:
        """`length` bytes from `offset` in the file, which lie in a chunk. Raises LogError where its CRC does
        not hold, StoreError where it cannot be fetched."""
        if self._is_verified[number] and self._cached is not None:
            data = self._cached.read(offset, length)
            if len(data) == length:
                return data
        offset -= self._chunks[number].start
        return self.record(number)[offset : offset + length]

    def record(self, number: int) -> bytes:
        """All of a chunk, as it is in the file. Raises what `read` does."""
        while True:
            with self._lock:
                if number in self._damaged:
                    raise self._damaged[number]
                if number in self._kept:
                    self._kept.move_to_end(number)
                    return self._kept[number]
                coming = self._coming.get(number)
            if coming is not None:
                return coming.result()
            if (record := self._on_disk(number)) is not None:
                return record
            if (fetched := self.fetch([number]).get(number)) is not None:
                return fetched.result()

    def sizes(self, numbers: Sequence[int]) -> int:
        """Bytes of these chunks."""
        return sum(self._chunks[number].end - self._chunks[number].start for number in numbers)

    def missing(self, numbers: Sequence[int]) -> list[int]:
        """The numbers of these chunks that are neither here nor on their way."""
        with self._lock:
            taken = self._coming.keys() | self._kept.keys() | self._damaged.keys()
            unknown = [each for each in numbers if each not in taken]
        return [number for number in unknown if not self._has(number)]

    def runs(self, numbers: Sequence[int]) -> Iterator[list[int]]:
        """Chunks, in their order, in groups that one request each can fetch: neighbours, and not too many."""
        run: list[int] = []
        for number in numbers:
            if run:
                gap = self._chunks[number].start - self._chunks[run[-1]].end
                size = self._chunks[number].end - self._chunks[run[0]].start
                if gap > GAP_BYTES or size > MAX_BYTES:
                    yield run
                    run = []
            run.append(number)
        if run:
            yield run

    def fetch(self, run: Sequence[int]) -> dict[int, Future[bytes]]:
        """Fetch chunks that lie side by side, but those that others fetch already, in one request; each of them,
        or what is wrong with it. Raises what `read` does where the request fails: threads that wait for one of
        them get the error, too, and later calls try again."""
        from concurrent.futures import Future

        with self._lock:
            futures: dict[int, Future[bytes]] = {
                number: Future() for number in run if number not in self._coming and number not in self._kept
            }
            self._coming.update(futures)
        try:
            self._fill(futures)
        except BaseException as error:
            for future in futures.values():
                if not future.done():
                    future.set_exception(error)
            raise
        finally:
            with self._lock:
                for number in futures:
                    del self._coming[number]
        return futures

    def _fill(self, futures: Mapping[int, Future[bytes]]) -> None:
        wanted = []
        for number, future in futures.items():
            if (
                self._has(number) and (record := self._on_disk(number)) is not None
            ):  # another process has fetched it
                future.set_result(record)
            else:
                wanted.append(number)
        if not wanted:
            return
        start, end = self._chunks[wanted[0]].start, self._chunks[wanted[-1]].end
        data = self._file.read_alone(start, end - start)
        for number in wanted:
            record = data[self._chunks[number].start - start : self._chunks[number].end - start]
            try:
                self._take(number, record)
            except LogError as error:
                with self._lock:
                    self._damaged[number] = error
                futures[number].set_exception(error)
            else:
                futures[number].set_result(record)

    def _take(self, number: int, record: bytes) -> None:
        """Keep a chunk whose CRC holds. Raises LogError for another."""
        chunk = self._chunks[number]
        self._file.records_in(chunk, record)
        if self._cached is not None and self._cached.keep(chunk.start, record):
            self._is_verified[number] = True
            return
        with self._lock:
            self._kept[number] = record
            while sum(map(len, self._kept.values())) > _KEPT_BYTES:
                self._kept.popitem(last=False)

    def _has(self, number: int) -> bool:
        """True if a chunk is on the disk, by its header alone."""
        if self._cached is None:
            return False
        chunk = self._chunks[number]
        head = chunk.head or bytes([Opcode.CHUNK])
        return self._cached.read(chunk.start, len(head)) == head

    def _on_disk(self, number: int) -> bytes | None:
        """A chunk as it is on the disk, if its CRC holds."""
        chunk = self._chunks[number]
        if self._cached is None or not self._has(number):
            return None
        record = self._cached.read(chunk.start, chunk.end - chunk.start)
        try:
            self._file.records_in(chunk, record)
        except LogError:
            return None
        self._is_verified[number] = True
        return record
