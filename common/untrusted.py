"""Opening untrusted files and following links: none may block the process, take all of its memory, or end it."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final

# A pipe that nobody writes to would be waited for; a terminal would become ours.
_FLAGS: Final = (
    os.O_RDONLY
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_NOCTTY", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)


def open_regular(path: Path | str) -> BinaryIO:
    """Open a file for reading. Raises OSError also for a pipe, a device or a folder, and never waits for one."""
    descriptor, _ = _opened(path)
    return os.fdopen(descriptor, "rb")


def read_bounded(path: Path | str, max_bytes: int) -> bytes:
    """Read all of a file. Raises OSError where `open_regular` does, and for one that is larger than `max_bytes`.

    The size is asked for first: a file that is all hole takes no space on a disk, but would in memory.
    """
    descriptor, size = _opened(path)
    try:
        if size > max_bytes:
            raise OSError(errno.EFBIG, f"larger than {max_bytes / 1e6:.0f} MB", str(path))
        data = os.read(descriptor, size)
        while len(data) < size and (more := os.read(descriptor, size - len(data))):
            data += more
        return data
    finally:
        os.close(descriptor)


def real_path(path: Path) -> Path:
    """The path without links, absolute. A link that leads to itself stays as it is, where Path.resolve raises."""
    return Path(os.path.realpath(path))


def _opened(path: Path | str) -> tuple[int, int]:
    """Open a regular file: its descriptor and its size."""
    try:
        descriptor = os.open(path, _FLAGS)
    except ValueError:  # a zero byte in it
        raise OSError(errno.ENOENT, "no such name", str(path)) from None
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor, status.st_size
