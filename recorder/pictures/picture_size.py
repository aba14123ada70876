"""Untrusted pictures: their decoding, and what a JPEG or PNG shows without it: its size, the cost of decoding it,
and whether it is whole.

A few kilobytes may take gigabytes or minutes to decode. Decoding any picture takes 13 times as long as the search
for its end: a JPEG is walked from marker to marker (ITU-T T.81, annex B), and its coded data is searched for wrong
markers. A PNG is walked from chunk to chunk (https://www.w3.org/TR/png/#5Chunk-layout).
"""

from __future__ import annotations

import re
import struct
import zlib
from typing import Final

import numpy as np
from numpy.typing import NDArray

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
    try:
        if picture.startswith(PNG_START):
            width, height = struct.unpack_from(">II", picture, 16)
            return width, height
        if picture.startswith(_JPEG_START):
            height, width = struct.unpack_from(">HH", picture, _frame(picture) + 3)
            return width, height
    except (struct.error, IndexError, ValueError):
        pass
    return None


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


PADDING_BYTES: Final = 64  # of a PNG; behind a JPEG's end, cameras that hand out their buffer leave anything

_END, _SOS = 0xD9, 0xDA
_ALONE: Final = frozenset(range(0xD0, 0xD9))
# lossless and hierarchical frames
_OTHER_FRAMES: Final = frozenset((0xC3, 0xC5, 0xC6, 0xC7, 0xC8, 0xCB, 0xCD, 0xCE, 0xCF))
# In coded data, 0xFF is followed by 0 if it is data; otherwise it is filling or begins a restart.
_SCAN_END: Final = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")

# Of a PNG.
_CHUNK: Final = struct.Struct(">I4s")  # length and type; the content and its CRC follow
_CRC: Final = struct.Struct(">I")
_NO_CONTENT: Final = _CHUNK.size + _CRC.size


def is_whole_jpeg(data: bytes) -> bool:
    """True for one complete JPEG of a kind that OpenCV decodes: baseline or progressive."""
    return whole_jpeg_size(data) is not None


def whole_jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of a JPEG that is complete (`is_whole_jpeg`); None for other bytes."""
    size = width_and_height(data) if data.startswith(_JPEG_START) and not has_too_many_scans(data) else None
    if size is None or not 0 < size[0] * size[1] <= MAX_PIXELS:
        return None
    try:
        end = _find_end(data)  # what comes behind it is not looked at
    except (ValueError, IndexError):  # IndexError: cut off
        return None
    return size if end <= len(data) else None


def _find_end(data: bytes) -> int:
    """The offset after the end marker. Raises ValueError or IndexError if the picture has no sound end."""
    has_scan, position = False, len(_JPEG_START)
    while True:
        if data[position] != 0xFF:
            raise ValueError("no marker")
        while (marker := data[position + 1]) == 0xFF:
            position += 1
        if marker == _END and has_scan:
            return position + 2
        length = data[position + 2] << 8 | data[position + 3]
        if marker < 0xC0 or marker in _ALONE or marker in _OTHER_FRAMES or length < 2:
            raise ValueError("a marker that OpenCV does not decode")
        position += 2 + length
        if marker == _SOS:
            has_scan = True
            if (end := _SCAN_END.search(data, position)) is None:
                raise ValueError("cut off")
            position = end.start()


def whole_png_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of a PNG with all its chunks and matching CRCs; None for other bytes."""
    if not data.startswith(PNG_START):
        return None
    at, kinds = len(PNG_START), list[bytes]()
    while kinds[-1:] != [b"IEND"]:
        if at + _NO_CONTENT > len(data):
            return None
        length, kind = _CHUNK.unpack_from(data, at)
        crc_at = at + _CHUNK.size + length
        if crc_at + _CRC.size > len(data):
            return None
        if zlib.crc32(memoryview(data)[at + 4 : crc_at]) != _CRC.unpack_from(data, crc_at)[0]:
            return None
        kinds.append(kind)
        at = crc_at + _CRC.size
    size = width_and_height(data)
    if kinds[0] != b"IHDR" or b"IDAT" not in kinds or size is None or len(data) - at > PADDING_BYTES:
        return None
    return size if 0 < size[0] * size[1] <= MAX_PIXELS else None


_REDUCED_GRAYSCALE_8: Final = 64
"""cv2.IMREAD_REDUCED_GRAYSCALE_8: faster, but it still reads the whole picture."""
MIN_ROWS: Final = 2
MAX_HEIGHT: Final = 4  # multiple of the width: otherwise, a column of 60,000 pixels would become gigabytes


def decode_picture(picture: bytes, flags: int) -> NDArray[np.uint8] | None:
    """A JPEG or PNG as OpenCV decodes it with these flags (cv2.IMREAD_...), (height, width) or (height, width, 3).

    None for other bytes, too many pixels or scans, or an incomplete picture. Wrong bytes inside the coded picture
    may decode to a wrong picture, which nothing distinguishes from a right one.
    """
    if decoding_problem(picture):
        return None
    import cv2  # only users of pictures need its memory

    try:
        decoded = cv2.imdecode(np.frombuffer(picture, np.uint8), flags)
    except cv2.error:  # a header that promises more columns than OpenCV allows
        return None
    return None if decoded is None else decoded.astype(np.uint8, copy=False)


def decodes(picture: bytes) -> bool:
    return decode_picture(picture, _REDUCED_GRAYSCALE_8) is not None


def is_whole_picture(picture: bytes) -> bool:
    """True for one complete JPEG or PNG that OpenCV decodes."""
    return decodes(picture) if picture.startswith(PNG_START) else is_whole_jpeg(picture)


def scaled_to_width(picture: NDArray[np.uint8], width_px: int) -> NDArray[np.uint8] | None:
    """A picture (height, width) of at least one row, scaled to a width. None if the result has fewer than
    `MIN_ROWS` rows, or is more than `MAX_HEIGHT` times as high as wide."""
    import cv2

    height, width = picture.shape
    height_px = round(height * width_px / width)
    if not MIN_ROWS <= height_px <= MAX_HEIGHT * width_px:
        return None
    scaled = cv2.resize(picture, (width_px, height_px), interpolation=cv2.INTER_AREA)
    return scaled.astype(np.uint8, copy=False)
