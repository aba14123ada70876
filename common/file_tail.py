"""The lines of a text file that another program is still appending to."""

from __future__ import annotations

import errno
from pathlib import Path
from stat import S_ISREG
from typing import Final

from common.text_lines import LineSplitter
from common.untrusted import open_regular

_COMPARED_BYTES: Final = 1024
_MAX_AT_ONCE: Final = 1 << 20


class FileTail:
    """Reads on where it stopped; a file that was made shorter or replaced is read again from its start.

    Lines end with \\n, \\r\\n or \\r. Of a line that is longer than `max_line_bytes`, so much and a byte more is
    given.
    """

    def __init__(self, path: Path, max_line_bytes: int) -> None:
        self.path = path
        self.line_count = 0
        """Lines of the present file that were read so far."""
        self.is_behind = False
        """True if there is more than the last call has read: it reads a megabyte, so that nothing waits long."""
        self._most_line_bytes = max_line_bytes
        self._status: tuple[int, ...] = ()  # of the file, when it was last read
        self._offset = 0
        self._end = b""  # of what was read: still there, unless the file was replaced
        self._splitter = LineSplitter(max_line_bytes)

    def new_lines(self) -> list[tuple[int, bytes]]:
        """The lines that were completed since the last call, with their numbers in the file, from 1.

        A file that is not there has no lines. Raises OSError for one that cannot be read now.
        """
        self.is_behind = False
        try:
            data = self._read_on()
        except FileNotFoundError:
            return []
        return self._numbered(self._splitter.feed(data))

    def rest(self) -> list[tuple[int, bytes]]:
        """The last line, if it has no end: for when nothing more will come."""
        content = self._splitter.rest()
        return self._numbered([content] if content else [])

    def _numbered(self, lines: list[bytes]) -> list[tuple[int, bytes]]:
        first = self.line_count + 1
        self.line_count += len(lines)
        return list(enumerate(lines, first))

    def _read_on(self) -> bytes:
        """The bytes that were appended; b"" if the file is as it was."""
        stat = self.path.stat()
        status = (stat.st_dev, stat.st_ino, stat.st_size, stat.st_mtime_ns)
        if status == self._status:
            return b""
        if not S_ISREG(stat.st_mode):  # opened and closed, a pipe would kill its writer
            raise OSError(errno.EINVAL, "not a regular file", str(self.path))
        with open_regular(self.path) as stream:
            is_same = status[:2] == self._status[:2] and stat.st_size >= self._offset
            stream.seek(max(self._offset - len(self._end), 0))
            if not is_same or stream.read(len(self._end)) != self._end:
                self._start_again()
                stream.seek(0)
            data = stream.read(_MAX_AT_ONCE)
        self.is_behind = len(data) == _MAX_AT_ONCE
        self._offset += len(data)
        self._status = status if self._offset >= stat.st_size else (*status[:2], -1, -1)
        self._end = (self._end + data)[-_COMPARED_BYTES:]
        return data

    def _start_again(self) -> None:
        self._offset = self.line_count = 0
        self._end = b""
        self._splitter = LineSplitter(self._most_line_bytes)
