"""Files that are read at any place, from any thread: one interface for this machine's and for those in stores."""

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
    """Bytes, when it was opened or has last grown."""
    is_remote: bool
    """True where a request takes long, however few bytes it is for."""

    def grow(self) -> bool:
        """Take in what was written behind the end since; False if the file has been deleted."""

    def read(self, offset: int, length: int) -> bytes:
        """`length` bytes from `offset`; fewer where the file ends before. Raises OSError or StoreError."""

    def read_many(self, ranges: Iterable[tuple[int, int]]) -> Iterator[bytes]:
        """The bytes of each range (first byte, number of bytes), in their order; later ones are requested
        meanwhile. Raises what `read` does."""

    def close(self) -> None: ...


class LocalFile(Closeable):
    is_remote = False

    def __init__(self, path: os.PathLike[str]) -> None:
        """Raises OSError, also for what is no plain file."""
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
        if sys.platform == "win32":  # no pread there
            with self._lock:
                self._stream.seek(offset)
                return self._stream.read(length)
        return os.pread(self._stream.fileno(), length, offset)

    def read_many(self, ranges: Iterable[tuple[int, int]]) -> Iterator[bytes]:
        return (self.read(offset, length) for offset, length in ranges)


def is_there(place: Location) -> bool:
    """True if there is a file, or an object, of this name. Raises StoreError."""
    if isinstance(place, Url):
        from common.object_store import find_object

        return find_object(place) is not None
    return place.is_file()


def read_bytes(place: Location, most: int) -> bytes | None:
    """All of a small file, or its first `most` bytes; None if there is none. Raises OSError or, also
    for a larger one, StoreError."""
    if isinstance(place, Url):
        from common.object_store import read_object

        return read_object(place, most)
    try:
        with place.open("rb") as stream:
            return stream.read(most)
    except FileNotFoundError:
        return None


def open_for_reading(place: Location) -> RandomAccess:
    """Raises OSError; StoreError for an object that cannot be read."""
    if isinstance(place, Url):
        from common.object_file import ObjectFile  # an extra, which nobody with one machine needs

        return ObjectFile(place)
    return LocalFile(place)
