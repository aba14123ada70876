"""Read an object in a store like a file: at any offset, from any thread, and always the same version."""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Final, NoReturn, TypeVar

from common.closeable import Closeable
from common.errors import ObjectChangedError, StoreError
from common.location import Url
from common.store_connection import store_of
from common.store_errors import as_store_error, is_cut_off, is_out_of_range, obstore
from common.store_errors import exceptions as failures

if TYPE_CHECKING:
    from obstore import GetOptions, ObjectMeta, SuffixRange

AT_ONCE: Final = 16
"""Requests in flight: with 50 ms and 256 KB for each, about 80 MB/s."""

MAX_READ_AHEAD: Final = 1 << 23
"""The most bytes that are read ahead in one request."""

T = TypeVar("T")
Range = tuple[int, int]
"""First byte, number of bytes."""

_MAX_ATTEMPTS: Final = 4  # for a request whose answer is cut off
_MIN_READ: Final = 1 << 15  # bytes; a smaller read is extended, because the next records are usually read next
_MAX_KEPT_BYTES: Final = 1 << 26
_MAX_KEPT_STRETCHES: Final = 16
_END_BYTES: Final = 1 << 17  # the end of a file, read at opening: the summary of a log is at its end


class ObjectFile(Closeable):
    """An object, open for reading at any offset, from any thread. If the object is replaced while it is open,
    reading raises ObjectChangedError."""

    is_remote = True

    def __init__(self, url: Url) -> None:
        """Open the object and read its end: one request, or two from Azure, which cannot count bytes from the end.
        Raises NoSuchObjectError or another StoreError."""
        self.url = url
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, bytes] = OrderedDict()  # by the offset of the first byte
        self._read_from = self._read_to = -1  # begin and end (exclusive) of the latest read
        self._ahead = _MIN_READ
        self._pool: ThreadPoolExecutor | None = None
        with as_store_error(url):
            try:
                meta, data = read_part(url, {"suffix": _END_BYTES})
                is_end = True
            except failures.NotSupportedError:
                meta, data = read_part(url, (0, _MIN_READ))
                is_end = len(data) == meta["size"]
        self.size: int = meta["size"]
        self.e_tag: str = meta["e_tag"] or ""  # every later write gives the object another one
        self._keep(self.size - len(data) if is_end else 0, data)
        if not is_end:
            last = min(_END_BYTES, self.size)
            self._keep(self.size - last, self._fetched(self.size - last, last))

    def close(self) -> None:
        self._kept.clear()
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def grow(self) -> bool:
        """Objects do not grow."""
        return True

    def read(self, offset: int, length: int) -> bytes:
        if (data := self._kept_bytes(offset, length)) is not None:
            return data
        with self._lock:
            # the latest read may already have the first bytes of the next record
            is_next = self._read_from <= offset <= self._read_to
            self._ahead = min(2 * self._ahead, MAX_READ_AHEAD) if is_next else _MIN_READ
            wanted = max(length, self._ahead if is_next or length < _MIN_READ else 0)
        data = self._fetched(offset, wanted)
        self._keep(offset, data)
        return data[:length]

    def read_many(self, ranges: Iterable[Range]) -> Iterator[bytes]:
        with self._lock:
            pool = self._pool = self._pool or ThreadPoolExecutor(AT_ONCE, "store")
        waiting: deque[Future[bytes]] = deque()
        for offset, length in ranges:
            data = self._kept_bytes(offset, length)
            waiting.append(pool.submit(self._fetched, offset, length) if data is None else _done(data))
            if len(waiting) == 2 * AT_ONCE:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()

    def read_from(self, start: int = 0, part_bytes: int = MAX_READ_AHEAD) -> Iterator[bytes]:
        """Yield the bytes from `start` to the end, in parts of `part_bytes`. Raises the errors of `read_many`."""
        starts = range(start, self.size, part_bytes)
        return self.read_many((at, min(part_bytes, self.size - at)) for at in starts)

    def _fetched(self, offset: int, length: int) -> bytes:
        length = min(length, self.size - offset)
        if length <= 0:
            return b""

        def part() -> bytes | None:
            options: GetOptions = {"range": (offset, offset + length)}
            if self.e_tag:
                options["if_match"] = self.e_tag
            try:
                answer = obstore.get(store_of(self.url, True), self.url.key, options=options)
                if (answer.meta["e_tag"] or "") != self.e_tag or answer.meta["size"] != self.size:
                    self._changed()
                data = answer.bytes().to_bytes()
            except failures.PreconditionError:
                self._changed()
            except FileNotFoundError:
                raise ObjectChangedError(f"{self.url}: was removed while it was read") from None
            except failures.GenericError as error:
                if is_out_of_range(str(error)):  # the range was within the size, so the object has changed
                    self._changed()
                raise
            return data if len(data) == length else None

        with as_store_error(self.url):
            return again_if_cut_off(self.url, part)

    def _changed(self) -> NoReturn:
        raise ObjectChangedError(
            f"{self.url}: was replaced while it was read (another ETag or size than"
            f" {self.e_tag or self.size}); give the command again"
        )

    def _kept_bytes(self, offset: int, length: int) -> bytes | None:
        with self._lock:
            for start, data in self._kept.items():
                if start <= offset and offset + length <= start + len(data):
                    self._kept.move_to_end(start)
                    return data[offset - start : offset - start + length]
        return None

    def _keep(self, offset: int, data: bytes) -> None:
        with self._lock:
            self._kept[offset] = data
            self._read_from, self._read_to = offset, offset + len(data)
            while len(self._kept) > _MAX_KEPT_STRETCHES or sum(map(len, self._kept.values())) > _MAX_KEPT_BYTES:
                self._kept.popitem(last=False)


def read_part(url: Url, part: tuple[int, int] | SuffixRange) -> tuple[ObjectMeta, bytes]:
    """The metadata of an object, and the bytes of a part, which may extend beyond the end of the object."""

    def answer() -> tuple[ObjectMeta, bytes] | None:
        result = obstore.get(store_of(url, False), url.key, options={"range": part})
        data = result.bytes().to_bytes()
        return (result.meta, data) if len(data) == result.range[1] - result.range[0] else None

    try:
        return again_if_cut_off(url, answer)
    except failures.GenericError as error:
        if is_out_of_range(str(error)):  # the part begins beyond the end, or the object is empty
            return obstore.head(store_of(url, False), url.key), b""
        raise


def again_if_cut_off(
    url: Url, request: Callable[[], T | None], may_repeat: Callable[[], bool] = lambda: True
) -> T:
    """The answer to a request. If the answer is cut off, `request` raises GenericError or returns None, and is
    called again. obstore itself repeats requests without an answer. Raises obstore's errors, and StoreError."""
    for attempt in range(1, _MAX_ATTEMPTS + 1):
        try:
            if (answer := request()) is not None:
                return answer
        except failures.GenericError as error:
            if attempt == _MAX_ATTEMPTS or not (is_cut_off(str(error)) and may_repeat()):
                raise
    raise StoreError(f"{url}: the download was cut off {_MAX_ATTEMPTS} times")


def _done(data: bytes) -> Future[bytes]:
    future: Future[bytes] = Future()
    future.set_result(data)
    return future
