"""Opening files that somebody else has made: nothing that they are may block, or take all memory."""

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


def read_bounded(path: Path | str, most_bytes: int) -> bytes:
    """All of a file. Raises OSError where `open_regular` does, and for one that is larger than `most_bytes`.

    The size is asked for first: a file that is all hole takes no space on a disk, but would in memory.
    """
    descriptor, size = _opened(path)
    try:
        if size > most_bytes:
            raise OSError(errno.EFBIG, f"larger than {most_bytes / 1e6:.0f} MB", str(path))
        data = os.read(descriptor, size)
        while len(data) < size and (more := os.read(descriptor, size - len(data))):
            data += more
        return data
    finally:
        os.close(descriptor)


def _opened(path: Path | str) -> tuple[int, int]:
    """The descriptor of a regular file, and its size."""
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
