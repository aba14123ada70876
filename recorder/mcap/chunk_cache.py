"""Chunks of logs in stores, kept on this machine's disk: what was fetched once is read as from a disk.

A file a log, named after its fingerprint, with each chunk where it lies in the log; what was not fetched is a
hole, which takes no room. Any number of processes share it without a word between them: nothing in it is believed
before its CRC holds, so whatever is not there, half-written, or damaged is fetched.

BC_CACHE names another folder than that of the system, BC_CACHE_GB how much it may hold (100). Where that is full,
the logs that were not used for longest go; if there are none but those in use, what comes is not kept: to keep a
part is better than to replace all of it in each epoch. A gigabyte of the disk always stays free.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import sys
import threading
from pathlib import Path
from typing import Final

from common.closeable import Closeable
from common.errors import UsageError
from common.users_cache import users_cache

_DEFAULT_GB: Final = 100.0
_STAYS_FREE: Final = 10**9  # bytes of the disk
_MAKE_ROOM_EVERY: Final = 50  # room is made after a fiftieth of what it may hold was added
_MAX_BETWEEN: Final = 1 << 30
_BLOCK_BYTES: Final = 512  # that a file's status counts in

_LOG: Final = logging.getLogger(__name__)


class ChunkCache:
    """A folder of parts of logs. May be used from any thread."""

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self.folder = folder
        self.max_bytes = max_bytes
        self._in_use: set[str] = set()
        self._lock = threading.Lock()
        self._added = max_bytes  # room is made before the first chunk is kept
        self._is_full = False
        self._has_warned = False

    def open(self, fingerprint: str) -> CachedLog | None:
        """The kept part of a log; None, with a warning, if nothing can be kept."""
        path = self.folder / f"{fingerprint[:32]}.part-of-log"
        self._in_use.add(path.name)
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0)
            descriptor = os.open(path, flags, 0o600)
            os.utime(path)
        except OSError as error:
            self.warn(f"cannot be written ({error.strerror})")
            return None
        return CachedLog(self, descriptor)

    def has_room(self, size: int) -> bool:
        """True if so many bytes more may be kept."""
        with self._lock:
            self._added += size
            if self._added >= min(self.max_bytes // _MAKE_ROOM_EVERY, _MAX_BETWEEN):
                self._added = 0
                self._make_room(size)
            return not self._is_full

    def warn(self, why: str) -> None:
        """Log a warning, once, why something is not kept."""
        if not self._has_warned:
            self._has_warned = True
            _LOG.warning(
                "%s: the cache of what was read from the store %s: some of it is read again each time"
                " (BC_CACHE names another folder, BC_CACHE_GB how much it may hold)",
                self.folder,
                why,
            )

    def _make_room(self, size: int) -> None:
        """Remove the logs that were not used for longest, but those in use here, until all may be kept."""
        logs: list[tuple[float, int, Path]] = []
        with contextlib.suppress(OSError):
            for path in self.folder.iterdir():
                with contextlib.suppress(OSError):
                    status = path.stat()
                    blocks = getattr(status, "st_blocks", None)  # Windows has none, and no holes
                    held = status.st_size if blocks is None else blocks * _BLOCK_BYTES
                    logs.append((status.st_mtime, held, path))
        held = sum(each for _, each, _ in logs) + size
        most = self.max_bytes
        with contextlib.suppress(OSError):
            most = min(most, held - size + shutil.disk_usage(self.folder).free - _STAYS_FREE)
        for _, freed, path in sorted(logs):
            if held <= most:
                break
            if path.name not in self._in_use:
                with contextlib.suppress(OSError):
                    path.unlink()
                    held -= freed
        self._is_full = held > most
        if self._is_full:
            self.warn("is full")


class CachedLog(Closeable):
    """The kept part of one log, each byte where it lies in the log. May be used from any thread."""

    def __init__(self, cache: ChunkCache, descriptor: int) -> None:
        self._cache = cache
        self._descriptor = descriptor
        self._lock = threading.Lock()

    def close(self) -> None:
        os.close(self._descriptor)

    def read(self, offset: int, length: int) -> bytes:
        """These bytes, if they are here; zeros, or fewer, if not."""
        try:
            if sys.platform == "win32":  # no pread there
                with self._lock:
                    os.lseek(self._descriptor, offset, os.SEEK_SET)
                    return os.read(self._descriptor, length)
            return os.pread(self._descriptor, length, offset)
        except OSError:
            return b""

    def keep(self, offset: int, data: bytes) -> bool:
        """Keep these bytes; False if there is no room for them, or they cannot be written."""
        if not self._cache.has_room(len(data)):
            return False
        try:
            written = self._write(offset, data)
        except OSError as error:
            self._cache.warn(f"cannot be written ({error.strerror})")
            return False
        if written < len(data):
            self._cache.warn("cannot be written (not all of a chunk fits)")
        return written == len(data)

    def _write(self, offset: int, data: bytes) -> int:
        if sys.platform == "win32":
            with self._lock, open(self._descriptor, "r+b", buffering=0, closefd=False) as stream:
                stream.seek(offset)
                return stream.write(data) or 0
        return os.pwrite(self._descriptor, data, offset)


def default_cache() -> ChunkCache:
    """The cache of this machine's user. Raises UsageError for a BC_CACHE_GB that is no number."""
    given = os.environ.get("BC_CACHE_GB", "")
    try:
        max_gb = float(given) if given else _DEFAULT_GB
    except ValueError:
        max_gb = -1.0
    if not 0 <= max_gb < 1e9:
        raise UsageError(f"BC_CACHE_GB={given}: a number of gigabytes was expected")
    return ChunkCache(users_cache() / "chunks", int(max_gb * 1e9))
