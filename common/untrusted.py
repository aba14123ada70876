"""Read untrusted files, links, numbers and JSON without blocking, filling the memory or ending the process."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final, TypeVar

import msgspec

Expected = TypeVar("Expected")

# Without these flags, opening a pipe would wait for its writer, and a terminal would become this process's own.
_FLAGS: Final = (
    os.O_RDONLY
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_NOCTTY", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)


def open_regular(path: Path | str) -> BinaryIO:
    """Open a regular file for reading, without waiting. Raises OSError, also for a pipe, a device or a folder."""
    descriptor, _ = _opened(path)
    return os.fdopen(descriptor, "rb")


def read_bounded(path: Path | str, max_bytes: int) -> bytes:
    """Read all of a file. Raises OSError as `open_regular` does, and if the file is larger than `max_bytes`.

    The size is checked before reading: a sparse file is small on the disk, but large in memory.
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
    """The absolute path without links. A link to itself stays in the path; `Path.resolve` would raise an error."""
    return Path(os.path.realpath(path))


def _opened(path: Path | str) -> tuple[int, int]:
    """Open a regular file. Returns its descriptor and its size in bytes."""
    try:
        descriptor = os.open(path, _FLAGS)
    except ValueError:  # the path contains a zero byte
        raise OSError(errno.ENOENT, "no such name", str(path)) from None
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor, status.st_size


def whole_number(text: str, max_digits: int = 15) -> int | None:
    """Parse a text of at most `max_digits` ASCII digits; None for any other text.

    `int` itself accepts signs, spaces and underscores, and raises ValueError for more than 4,300 digits.
    """
    return int(text) if text.isascii() and text.isdigit() and len(text) <= max_digits else None


def json_as(text: str | bytes, kind: type[Expected]) -> Expected | None:
    """The parsed JSON as a `kind`; None if it is no valid JSON of this type, or nested too deeply."""
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None
