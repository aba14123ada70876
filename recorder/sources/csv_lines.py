"""The lines of a csv that is read in blocks, or that another program still appends to."""

from __future__ import annotations

import errno
from pathlib import Path
from stat import S_ISREG
from typing import Final

from common.untrusted import open_regular
from recorder.sources.udacity_csv import MAX_LINE_BYTES

_COMPARED_BYTES: Final = 1024
_MAX_AT_ONCE: Final = 1 << 20


class LineSplitter:
    """Splits bytes at \\n, \\r\\n and \\r, as bytes.splitlines does. Keeps at most a block and a line.

    Longer lines are cut after `MAX_LINE_BYTES` + 1 bytes.
    """

    def __init__(self) -> None:
        self._partial = b""  # a line without an end yet
        self._skips_newline = False  # the last line ended with \r, perhaps the first half of \r\n

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that `data` completes, without their ends."""
        if self._skips_newline and data:
            data = data.removeprefix(b"\n")
            self._skips_newline = False
        if not data:
            return []
        pieces = (self._partial + data).splitlines(keepends=True)
        self._partial = b"" if pieces[-1].endswith((b"\n", b"\r")) else pieces.pop()[: MAX_LINE_BYTES + 1]
        self._skips_newline = not self._partial and pieces[-1].endswith(b"\r")
        return [piece.rstrip(b"\r\n")[: MAX_LINE_BYTES + 1] for piece in pieces]

    def rest(self) -> bytes:
        """The last line, if it has no end; else b"". Call it when nothing more will come."""
        last, self._partial = self._partial, b""
        return last


class CsvTail:
    """The lines of a growing csv. Each call continues where the last one stopped.

    A csv that was shortened or replaced is read again from its start, without the earlier lines. Equal lines in
    one csv are all returned.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_behind = False
        """True if the file has more to read: each call reads at most a megabyte."""
        self._status: tuple[int, ...] = ()  # of the file, when it was last read
        self._earlier_lines = set[int]()  # hashes: a day's drive has hundreds of thousands of lines
        self._lines = set[int]()
        self._end = b""  # the last bytes read, to recognise a replaced file
        self._start_again()

    def new_lines(self) -> list[tuple[int, bytes]]:
        """The lines completed since the last call, with their numbers in the file, from 1.

        A missing file has no lines. Raises OSError if the file cannot be read now.
        """
        self.is_behind = False
        try:
            data = self._read_on()
        except FileNotFoundError:
            return []
        return self._numbered(self._splitter.feed(data))

    def rest(self) -> list[tuple[int, bytes]]:
        """The last line, if it has no end. Call it when nothing more will come."""
        content = self._splitter.rest()
        return self._numbered([content] if content else [])

    def _numbered(self, lines: list[bytes]) -> list[tuple[int, bytes]]:
        first = self._line_count + 1
        self._line_count += len(lines)
        self._lines.update(map(hash, lines))
        numbered = enumerate(lines, first)
        return [(number, content) for number, content in numbered if hash(content) not in self._earlier_lines]

    def _read_on(self) -> bytes:
        """The appended bytes; b"" if the file has not changed."""
        stat = self.path.stat()
        status = (stat.st_dev, stat.st_ino, stat.st_size, stat.st_mtime_ns)
        if status == self._status:
            return b""
        if not S_ISREG(stat.st_mode):  # opening and closing a pipe would kill its writer
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
        self._offset = self._line_count = 0
        self._end = b""
        self._splitter = LineSplitter()
        self._earlier_lines |= self._lines
        self._lines = set()
