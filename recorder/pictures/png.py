"""Recognising a whole PNG by its chunks (https://www.w3.org/TR/png/#5Chunk-layout), without decoding it: OpenCV
prints an error for each that is cut off.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final

from recorder.pictures.jpeg import PADDING_BYTES
from recorder.pictures.picture_size import MAX_PIXELS, PNG_START, width_and_height

_CHUNK: Final = struct.Struct(">I4s")  # length and type; the content and its CRC follow
_CRC: Final = struct.Struct(">I")
_NO_CONTENT: Final = _CHUNK.size + _CRC.size


def whole_png_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of a PNG whose chunks are all there, with CRCs that hold; None for anything else."""
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
