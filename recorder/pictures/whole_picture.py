"""Recognises a whole JPEG or PNG without decoding it.

A JPEG is walked from marker to marker (ITU-T T.81, annex B) up to its end, and its coded data is searched for
wrong markers. Decoding takes 13 times as long (an import falls from 15,000 to 5,200 pictures a second), and
seconds for 30 KB with hundreds of scans. A PNG is walked from chunk to chunk
(https://www.w3.org/TR/png/#5Chunk-layout): OpenCV would print an error for each picture that is cut off.
"""

from __future__ import annotations

import re
import struct
import zlib
from typing import Final

from recorder.pictures.picture_size import MAX_PIXELS, PNG_START, has_too_many_scans, width_and_height

PADDING_BYTES: Final = 64  # of a PNG; behind a JPEG's end, cameras that hand out their buffer leave anything

_START: Final = b"\xff\xd8"
_END, _SOS = 0xD9, 0xDA
_WITHOUT_LENGTH: Final = frozenset(range(0xD0, 0xD9))
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
    size = width_and_height(data) if data.startswith(_START) and not has_too_many_scans(data) else None
    if size is None or not 0 < size[0] * size[1] <= MAX_PIXELS:
        return None
    try:
        end = _find_end(data)  # what comes behind it is not looked at
    except (ValueError, IndexError):  # IndexError: cut off
        return None
    return size if end <= len(data) else None


def _find_end(data: bytes) -> int:
    """The offset after the end marker. Raises ValueError or IndexError if the picture has no sound end."""
    has_scan, position = False, len(_START)
    while True:
        if data[position] != 0xFF:
            raise ValueError("no marker")
        while (marker := data[position + 1]) == 0xFF:
            position += 1
        if marker == _END and has_scan:
            return position + 2
        length = data[position + 2] << 8 | data[position + 3]
        if marker < 0xC0 or marker in _WITHOUT_LENGTH or marker in _OTHER_FRAMES or length < 2:
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
