"""Advisory locks on open files, which their writers hold. The system releases them when the process dies."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import IO, Final

from common.location import Location

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_BEHIND: Final = 1 << 60  # on Windows nobody can read what is locked: a byte that no file has


def lock(stream: IO[bytes]) -> None:
    """Lock an open file until it is closed, once nobody else holds it. Raises OSError where there are no locks."""
    if sys.platform == "win32":
        _lock_behind(stream, msvcrt.LK_LOCK)
    else:
        fcntl.flock(stream, fcntl.LOCK_EX)


def try_lock(stream: IO[bytes]) -> bool:
    """Lock an open file until it is closed; False, at once, if somebody else holds it. Raises OSError where there
    are no locks."""
    try:
        if sys.platform == "win32":
            _lock_behind(stream, msvcrt.LK_NBLCK)
        else:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # on Windows the latter
        return False
    return True


def is_being_written(path: Location) -> bool:
    """True if a process of this machine is still writing the file at `path`.

    False where the file system knows no locks, for objects in a store, and for what is missing or no file.
    """
    try:
        if not isinstance(path, Path) or not path.is_file():  # opening a pipe would wait for its writer
            return False
        with path.open("rb") as stream:
            return _is_locked(stream)
    except OSError:
        return False


def _is_locked(stream: IO[bytes]) -> bool:
    try:
        if sys.platform == "win32":
            _lock_behind(stream, msvcrt.LK_NBLCK)
            _lock_behind(stream, msvcrt.LK_UNLCK)
        else:  # shared: two processes that ask at once do not take each other for the writer
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return True
    return False


if sys.platform == "win32":

    def _lock_behind(stream: IO[bytes], mode: int) -> None:
        position = stream.tell()
        stream.seek(_BEHIND)
        try:
            msvcrt.locking(stream.fileno(), mode, 1)
        finally:
            stream.seek(position)
