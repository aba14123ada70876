"""Advisory locks on open files. A writer holds the lock of its file; the system releases it when the process
dies."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import IO, Final

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_BEYOND_END: Final = 1 << 60
"""Windows: locked bytes cannot be read, so a byte beyond the end of every file is locked."""
_POLL_S: Final = 0.1


def lock(stream: IO[bytes]) -> None:
    """Wait for the lock of an open file, and keep it until the file is closed. Raises OSError if the file system
    has no locks."""
    if sys.platform == "win32":
        while not try_lock(stream):  # msvcrt itself gives up after ten seconds
            time.sleep(_POLL_S)
    else:
        fcntl.flock(stream, fcntl.LOCK_EX)


def try_lock(stream: IO[bytes]) -> bool:
    """Lock an open file until it is closed; return False, without waiting, if the lock is taken. Raises OSError if
    the file system has no locks."""
    try:
        if sys.platform == "win32":
            _lock_beyond_end(stream, msvcrt.LK_NBLCK)
        else:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # PermissionError: on Windows
        return False
    return True


def is_being_written(path: Path) -> bool:
    """True if a process of this machine is still writing the file at `path`.

    False for missing files and folders, and if the file system has no locks.
    """
    try:
        if not path.is_file():  # opening a pipe would wait for its writer
            return False
        with path.open("rb") as stream:
            return _is_locked(stream)
    except OSError:
        return False


def _is_locked(stream: IO[bytes]) -> bool:
    try:
        if sys.platform == "win32":
            _lock_beyond_end(stream, msvcrt.LK_NBLCK)
            _lock_beyond_end(stream, msvcrt.LK_UNLCK)
        else:  # shared: two processes that check at the same time do not take each other for the writer
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return True
    return False


if sys.platform == "win32":

    def _lock_beyond_end(stream: IO[bytes], mode: int) -> None:
        position = stream.tell()
        stream.seek(_BEYOND_END)
        try:
            msvcrt.locking(stream.fileno(), mode, 1)
        finally:
            stream.seek(position)
