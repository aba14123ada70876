"""The lines of a text file that another program is still appending to."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Final

_COMPARED_BYTES: Final = 1024


class Tail:
    """Reads on where it stopped; a file that was made shorter or replaced is read again from its start.

    Lines of such a file that were there before are not given a second time; those within one file are, as often
    as they are in it. Lines end with \\n, \\r\\n or \\r.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seen: tuple[int, ...] = ()  # of the file's status, when it was last read
        self._before: set[bytes] = set()  # lines of the file that was replaced
        self._lines: set[bytes] = set()
        self._offset = 0
        self._number = 0
        self._end = b""  # of what was read: still there, unless the file was replaced
        self._partial = b""  # a line whose end was not there yet
        self._skips_newline = False  # the last line ended with a \r that may be half of a \r\n

    def new_lines(self) -> list[tuple[int, bytes]]:
        """The lines that were completed since the last call, with their numbers in the file, from 1.

        A file that is not there, or cannot be read now, has none.
        """
        try:
            data = self._read_on()
        except OSError:
            return []
        if self._skips_newline and data:
            data = data.removeprefix(b"\n")
            self._skips_newline = False
        if not data:
            return []
        pieces = (self._partial + data).splitlines(keepends=True)
        self._partial = b"" if pieces[-1].endswith((b"\n", b"\r")) else pieces.pop()
        self._skips_newline = not self._partial and pieces[-1].endswith(b"\r")
        return [line for line in map(self._take, pieces) if line is not None]

    def rest(self) -> list[tuple[int, bytes]]:
        """The last line, if it has no end: for when nothing more will come."""
        last = self._take(self._partial) if self._partial else None
        self._partial = b""
        return [] if last is None else [last]

    def _take(self, piece: bytes) -> tuple[int, bytes] | None:
        self._number += 1
        content = piece.rstrip(b"\r\n")
        self._lines.add(content)
        return None if content in self._before else (self._number, content)

    def _read_on(self) -> bytes:
        """What was appended; b"" if the file is as it was."""
        status = self._path.stat()
        seen = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
        if seen == self._seen or not stat.S_ISREG(status.st_mode):  # opening a pipe would wait for its writer
            return b""
        with self._path.open("rb") as stream:
            is_same = seen[:2] == self._seen[:2] and status.st_size >= self._offset
            stream.seek(max(self._offset - len(self._end), 0))
            if not is_same or stream.read(len(self._end)) != self._end:
                self._start_again()
                stream.seek(0)
            data = stream.read()
        self._seen = seen
        self._offset += len(data)
        self._end = (self._end + data)[-_COMPARED_BYTES:]
        return data

    def _start_again(self) -> None:
        self._before |= self._lines
        self._lines = set()
        self._offset = self._number = 0
        self._end = self._partial = b""
        self._skips_newline = False
