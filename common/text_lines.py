"""The lines of a text that comes in pieces, without ever holding more than a piece and a line."""

from __future__ import annotations


class LineSplitter:
    """Splits bytes at \\n, \\r\\n and \\r, as bytes.splitlines does.

    A line that is longer than `max_bytes` is cut: so many of its bytes are given, and one more.
    """

    def __init__(self, max_bytes: int) -> None:
        self._kept_bytes = max_bytes + 1
        self._partial = b""  # a line whose end was not there yet
        self._skips_newline = False  # the last line ended with a \r that may be half of a \r\n

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that are complete with `data`, without their ends."""
        if self._skips_newline and data:
            data = data.removeprefix(b"\n")
            self._skips_newline = False
        if not data:
            return []
        pieces = (self._partial + data).splitlines(keepends=True)
        self._partial = b"" if pieces[-1].endswith((b"\n", b"\r")) else pieces.pop()[: self._kept_bytes]
        self._skips_newline = not self._partial and pieces[-1].endswith(b"\r")
        return [piece.rstrip(b"\r\n")[: self._kept_bytes] for piece in pieces]

    def rest(self) -> bytes:
        """The last line, if it has no end, for when nothing more will come; b"" without one."""
        last, self._partial = self._partial, b""
        return last
