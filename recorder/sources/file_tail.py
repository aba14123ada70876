"""The lines of a text file that another program is still appending to."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Final

from common.untrusted import open_regular
from recorder.sources.name_set import NameSet
from recorder.sources.text_lines import LineSplitter

_COMPARED_BYTES: Final = 1024
_MOST_AT_ONCE: Final = 1 << 20


class Tail:
    """Reads on where it stopped; a file that was made shorter or replaced is read again from its start.

    Lines of such a file that were there before are not given a second time; those within one file are, as often
    as they are in it. Lines end with \\n, \\r\\n or \\r.
    """

    def __init__(self, path: Path) -> None:
        self.is_behind = False
        """Whether more is there than the last call has read: it reads a megabyte, so that nothing waits long."""
        self._path = path
        self._seen: tuple[int, ...] = ()  # of the file's status, when it was last read
        self._before = NameSet()  # lines of the file that was replaced
        self._lines = NameSet()
        self._offset = 0
        self._number = 0
        self._end = b""  # of what was read: still there, unless the file was replaced
        self._splitter = LineSplitter()

    def new_lines(self) -> list[tuple[int, bytes]]:
        """The lines that were completed since the last call, with their numbers in the file, from 1.

        A file that is not there, or cannot be read now, has none.
        """
        self.is_behind = False
        try:
            data = self._read_on()
        except OSError:
            return []
        return [line for line in map(self._take, self._splitter.feed(data)) if line is not None]

    def rest(self) -> list[tuple[int, bytes]]:
        """The last line, if it has no end: for when nothing more will come."""
        content = self._splitter.rest()
        last = self._take(content) if content else None
        return [] if last is None else [last]

    def _take(self, content: bytes) -> tuple[int, bytes] | None:
        self._number += 1
        self._lines.add(content)
        return None if content in self._before else (self._number, content)

    def _read_on(self) -> bytes:
        """What was appended; b"" if the file is as it was."""
        status = self._path.stat()
        seen = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
        if seen == self._seen or not stat.S_ISREG(status.st_mode):
            return b""
        with open_regular(self._path) as stream:
            is_same = seen[:2] == self._seen[:2] and status.st_size >= self._offset
            stream.seek(max(self._offset - len(self._end), 0))
            if not is_same or stream.read(len(self._end)) != self._end:
                self._start_again()
                stream.seek(0)
            data = stream.read(_MOST_AT_ONCE)
        self.is_behind = len(data) == _MOST_AT_ONCE
        self._seen = (*seen[:2], -1, -1) if self.is_behind else seen
        self._offset += len(data)
        self._end = (self._end + data)[-_COMPARED_BYTES:]
        return data

    def _start_again(self) -> None:
        self._before.update(self._lines)
        self._lines = NameSet()
        self._offset = self._number = 0
        self._end = b""
        self._splitter = LineSplitter()
