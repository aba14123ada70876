"""The size of a JPEG or PNG, and the cost of decoding it: a few kilobytes may take gigabytes, or minutes."""

from __future__ import annotations

import struct
from typing import Final

from common.errors import counted

MAX_PIXELS: Final = 1 << 26
"""The largest decoded picture: up to 200 MB in memory. A car's camera has a hundredth of it."""

MAX_SCANS: Final = 100
"""A progressive picture has some ten scans. Each covers the whole picture: thousands of scans fit into 50 KB, and
take seconds."""

_MAX_SIZES: Final = 8  # listed for each camera

PNG_START: Final = b"\x89PNG\r\n\x1a\n"

_JPEG_START: Final = b"\xff\xd8"
_SCAN_START: Final = b"\xff\xda"
_WITHOUT_LENGTH: Final = frozenset({0x00, 0x01, *range(0xD0, 0xD8)})
_NO_FRAMES: Final = frozenset({0xC4, 0xC8, 0xCC})  # tables, numbered among the frames
_SCAN_OR_END: Final = frozenset({0xD9, 0xDA})


def width_and_height(picture: bytes) -> tuple[int, int] | None:
    """Width and height of a JPEG or PNG; None for other bytes, or if it is cut off before them."""
    size_at = _size_at(picture)
    return None if size_at is None else size_at[0]


def _size_at(picture: bytes) -> tuple[tuple[int, int], int] | None:
    """Width and height of a picture, and the end of the bytes that hold them."""
    try:
        if picture.startswith(PNG_START):
            width, height = struct.unpack_from(">II", picture, 16)
            return (width, height), 24
        if picture.startswith(_JPEG_START):
            at = _frame(picture) + 3
            height, width = struct.unpack_from(">HH", picture, at)
            return (width, height), at + 4
    except (struct.error, IndexError, ValueError):
        pass
    return None


class SizeReader:
    """Reads the sizes of many pictures. A picture with the same beginning as the last one is not searched."""

    def __init__(self) -> None:
        self._header = b""
        self._size = 0, 0

    def width_and_height(self, picture: bytes) -> tuple[int, int] | None:
        """As the function `width_and_height`, but quicker for pictures with the last one's header."""
        if not self._header or not picture.startswith(self._header):
            size_at = _size_at(picture)
            if size_at is None:
                return None
            self._size, end = size_at
            self._header = picture[:end]
        return self._size


def pixels(picture: bytes) -> int:
    """Width x height of a JPEG or PNG; 0 for other bytes, or if it is cut off before them."""
    width, height = width_and_height(picture) or (0, 0)
    return width * height


def decoding_problem(picture: bytes) -> str:
    """The reason not to decode a picture, from its header and its markers; empty for a JPEG or PNG within
    `MAX_PIXELS` and `MAX_SCANS`."""
    size = pixels(picture)
    if not size:
        return f"{counted(len(picture), 'byte')} that are not a picture"
    if size > MAX_PIXELS:
        return f"a picture of more than {MAX_PIXELS:,} pixels"
    return f"a JPEG of more than {MAX_SCANS} scans" if has_too_many_scans(picture) else ""


def has_too_many_scans(picture: bytes) -> bool:
    """True for a JPEG with more than `MAX_SCANS` markers of scans. Coded data has no markers; comments may."""
    return picture.startswith(_JPEG_START) and picture.count(_SCAN_START) > MAX_SCANS


class PictureSizes:
    """Counts the sizes of each camera's pictures, to report a camera that changes its size."""

    def __init__(self) -> None:
        self._sizes: dict[str, dict[tuple[int, int], tuple[int, int]]] = {}  # topic, size -> count, first row

    def add(self, topic: str, row: int, size: tuple[int, int] | None) -> None:
        """Count a picture of this width and height; None if unknown."""
        sizes = self._sizes.setdefault(topic, {})
        if size is not None and (size in sizes or len(sizes) < _MAX_SIZES):
            count, first_row = sizes.get(size, (0, row))
            sizes[size] = count + 1, first_row

    def mixed(self) -> dict[str, str]:
        """The sizes of each topic with several, the first size first."""
        return {
            topic: ", ".join(
                f"{counted(count, 'picture')} of {width}x{height} (first: row {row})"
                for (width, height), (count, row) in sizes.items()
            )
            for topic, sizes in sorted(self._sizes.items())
            if len(sizes) > 1
        }

    def notices(self) -> list[str]:
        """Lines to print about cameras whose pictures change their size, or differ in size from others."""
        lines = [f"pictures of different sizes on {topic}: {sizes}" for topic, sizes in self.mixed().items()]
        first = self.first()
        if not lines and len(set(first.values())) > 1:
            sizes = ", ".join(f"{width}x{height} on {topic}" for topic, (width, height) in first.items())
            lines = [f"pictures of different sizes: {sizes}; they should show the same part of the world"]
        return lines

    def first(self) -> dict[str, tuple[int, int]]:
        """Width and height of the first picture of each topic that has any."""
        return {topic: next(iter(sizes)) for topic, sizes in sorted(self._sizes.items()) if sizes}


def _frame(jpeg: bytes) -> int:
    """Offset of the content of the first frame's header (T.81, B.2.2), found as libjpeg finds it.

    Raises IndexError or ValueError if there is none.
    """
    position = 2
    while True:
        position = jpeg.index(0xFF, position)
        while (marker := jpeg[position]) == 0xFF:
            position += 1
        position += 1
        if 0xC0 <= marker < 0xD0 and marker not in _NO_FRAMES:
            return position
        if marker in _SCAN_OR_END:
            raise ValueError("no frame")
        if marker not in _WITHOUT_LENGTH:
            position += jpeg[position] << 8 | jpeg[position + 1]
