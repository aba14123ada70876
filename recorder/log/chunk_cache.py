"""Chunks of logs in stores, kept on this machine's disk: what was fetched once is read as from a disk.

A file a chunk, CHUNKS/FINGERPRINT/OFFSET, byte for byte as in the log. The fingerprint is the log file's, so that
a log which is replaced, or lies at two places, is never confused. Any number of processes share the folder without
a word between them: a file appears whole, and may vanish at any moment. Nothing in it is believed: the CRC of a
chunk is compared when it comes, and again when a process first reads it from the disk.

BC_CACHE names another folder than that of the system, BC_CACHE_GB how much it may hold (100). The oldest chunks,
by their last use, make room for new ones; a gigabyte of the disk always stays free.
"""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import shutil
import sys
import threading
from pathlib import Path
from typing import Final

from common.errors import UsageError

_DEFAULT_GB: Final = 100.0
_STAYS_FREE: Final = 10**9  # bytes of the disk
_LOOK_EVERY: Final = 50  # looked through after a fiftieth of what it may hold was added
_MOST_BETWEEN: Final = 1 << 30
_FULL: Final = 0.9  # of what it may hold is left when room is made

_LOG: Final = logging.getLogger(__name__)


class ChunkCache:
    """A folder of chunks. May be used from any thread."""

    def __init__(self, folder: Path, most_bytes: int) -> None:
        self.folder = folder
        self.most_bytes = most_bytes
        self._lock = threading.Lock()
        self._added = most_bytes  # looked through before the first one is kept
        self._is_off = False

    def path(self, fingerprint: str, start: int) -> Path:
        return self.folder / fingerprint[:32] / str(start)

    def read(self, fingerprint: str, start: int, offset: int, length: int) -> bytes | None:
        """`length` bytes of a chunk from `offset`; None if it is not here (any more)."""
        try:
            descriptor = os.open(self.path(fingerprint, start), os.O_RDONLY | getattr(os, "O_BINARY", 0))
        except OSError:
            return None
        try:
            if sys.platform == "win32":  # no pread there
                os.lseek(descriptor, offset, os.SEEK_SET)
                data = os.read(descriptor, length)
            else:
                data = os.pread(descriptor, length, offset)
        except OSError:
            return None
        finally:
            os.close(descriptor)
        return data if len(data) == length else None

    def has(self, fingerprint: str, start: int, length: int) -> bool:
        """True if a chunk is here, as far as its length tells."""
        try:
            return self.path(fingerprint, start).stat().st_size == length
        except OSError:
            return False

    def note_use(self, fingerprint: str, start: int) -> None:
        with contextlib.suppress(OSError):
            os.utime(self.path(fingerprint, start))

    def keep(self, fingerprint: str, start: int, record: bytes) -> bool:
        """Keep a chunk; False if there is no room for it, or it cannot be written."""
        with self._lock:
            self._added += len(record)
            if self._added >= min(self.most_bytes // _LOOK_EVERY, _MOST_BETWEEN):
                self._added = 0
                self._make_room()
            if self._is_off:
                return False
        path = self.path(fingerprint, start)
        part = path.with_name(f"{start}.{secrets.token_hex(3)}.part")
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            part.write_bytes(record)
            part.replace(path)
        except OSError as error:
            with contextlib.suppress(OSError):
                part.unlink()
            self._turn_off(f"cannot be written ({error.strerror})")
            return False
        return True

    def drop(self, fingerprint: str, start: int) -> None:
        with contextlib.suppress(OSError):
            self.path(fingerprint, start).unlink()

    def _make_room(self) -> None:
        """Remove the oldest chunks until all of them are no more than they may be."""
        found: list[tuple[float, int, str]] = []
        with contextlib.suppress(OSError):
            for folder in os.scandir(self.folder):
                with contextlib.suppress(OSError), os.scandir(folder.path) as files:
                    for file in files:
                        with contextlib.suppress(OSError):
                            status = file.stat()
                            found.append((status.st_mtime, status.st_size, file.path))
        held = sum(size for _, size, _ in found)
        most = self.most_bytes
        with contextlib.suppress(OSError):
            above = next(each for each in (self.folder, *self.folder.parents) if each.exists())
            most = min(most, held + shutil.disk_usage(above).free - _STAYS_FREE)
        if held > most:
            for _, size, path in sorted(found):
                with contextlib.suppress(OSError):
                    Path(path).unlink()
                held -= size
                if held <= _FULL * most:
                    break
        if most <= 0:
            self._turn_off("lies on a full disk")
        else:
            self._is_off = False

    def _turn_off(self, why: str) -> None:
        if not self._is_off:
            self._is_off = True
            _LOG.warning(
                "%s: the cache of what was read from the store %s; it is read anew each time it is needed"
                " (BC_CACHE names another folder)",
                self.folder,
                why,
            )


def default_cache() -> ChunkCache:
    """The cache of this machine's user. Raises UsageError for a BC_CACHE_GB that is no number."""
    given = os.environ.get("BC_CACHE_GB", "")
    try:
        most_gb = float(given) if given else _DEFAULT_GB
    except ValueError:
        most_gb = -1.0
    if not 0 <= most_gb < 1e9:
        raise UsageError(f"BC_CACHE_GB={given}: a number of gigabytes was expected")
    return ChunkCache(_folder() / "chunks", int(most_gb * 1e9))


def _folder() -> Path:
    if given := os.environ.get("BC_CACHE"):
        return Path(given)
    if sys.platform == "win32":
        above = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        above = Path.home() / "Library" / "Caches"
    else:
        above = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return above / "behavioural-cloning-toolkit"
