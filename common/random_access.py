"""Files that can be read at any offset, from any thread: one interface for local files and objects in a store."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterable, Iterator
from typing import Protocol

from common.closeable import Closeable
from common.location import Location, Url
from common.untrusted import open_regular


class RandomAccess(Protocol):
    """A file, open for reading."""

    size: int
    """Size in bytes when the file was opened, or at the last `grow`."""
    is_remote: bool
    """True if every request takes long, even for a few bytes."""

    def grow(self) -> bool:
        """Update `size` after another process has appended data; False if the file has been deleted."""

    def read(self, offset: int, length: int) -> bytes:
        """`length` bytes from `offset`, or fewer at the end of the file. Raises OSError or StoreError."""

    def read_many(self, ranges: Iterable[tuple[int, int]]) -> Iterator[bytes]:
        """Yield the bytes of each range (first byte, number of bytes), in order; the next ranges are requested in
        advance. Raises the errors of `read`."""

    def close(self) -> None: ...


class LocalFile(Closeable):
    is_remote = False

    def __init__(self, path: os.PathLike[str]) -> None:
        """Raises OSError, also if `path` is not a regular file."""
        self._stream = open_regular(os.fspath(path))
        self._lock = threading.Lock()
        self.size = 0
        self.grow()

    def close(self) -> None:
        self._stream.close()

    def grow(self) -> bool:
        status = os.fstat(self._stream.fileno())
        self.size = status.st_size
        return status.st_nlink > 0

    def read(self, offset: int, length: int) -> bytes:
        if sys.platform == "win32":  # Windows has no pread
            with self._lock:
                self._stream.seek(offset)
                return self._stream.read(length)
        return os.pread(self._stream.fileno(), length, offset)

    def read_many(self, ranges: Iterable[tuple[int, int]]) -> Iterator[bytes]:
        return (self.read(offset, length) for offset, length in ranges)


def read_bytes(place: Location, max_bytes: int) -> bytes | None:
    """All of a small file; None if it does not exist. Of a larger local file, the first `max_bytes`. Raises
    OSError; StoreError, also for a larger object."""
    if isinstance(place, Url):
        from common.object_store import read_object

        return read_object(place, max_bytes)
    try:
        with place.open("rb") as stream:
            return stream.read(max_bytes)
    except FileNotFoundError:
        return None


def open_for_reading(place: Location) -> RandomAccess:
    """Open a file or an object. Raises OSError; StoreError if the object cannot be read."""
    if isinstance(place, Url):
        from common.object_file import ObjectFile  # needs obstore, which is an optional package

        return ObjectFile(place)
    return LocalFile(place)
