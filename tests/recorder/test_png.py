"""A PNG is whole if its chunks are: OpenCV decodes it then, and nothing that is cut off or changed is taken."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.pictures.picture_size import PADDING_BYTES, whole_png_size

NOISE = np.random.default_rng(7).integers(0, 256, (40, 56, 4), np.uint8)
PNG = cv2.imencode(".png", NOISE[..., :3])[1].tobytes()


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png_of(width: int, height: int, *chunks: bytes) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"".join((PNG[:8], chunk(b"IHDR", header), *chunks, chunk(b"IEND", b"")))


@pytest.mark.parametrize("picture", [NOISE, NOISE[..., :3], NOISE[..., 0], NOISE[..., 0].astype(np.uint16) * 257])
def test_every_kind_that_opencv_writes_is_whole(picture: np.ndarray) -> None:
    assert whole_png_size(cv2.imencode(".png", picture)[1].tobytes()) == (56, 40)


@given(st.integers(0, len(PNG) - 1))
def test_what_is_cut_off_is_not_whole(length: int) -> None:
    assert whole_png_size(PNG[:length]) is None


@given(st.integers(0, len(PNG) - 1), st.integers(1, 255))
def test_no_changed_byte_goes_unnoticed(at: int, change: int) -> None:
    assert whole_png_size(PNG[:at] + bytes([PNG[at] ^ change]) + PNG[at + 1 :]) is None


def test_padding_is_allowed_and_more_is_not() -> None:
    assert whole_png_size(PNG + bytes(PADDING_BYTES)) == (56, 40)
    assert whole_png_size(PNG + bytes(PADDING_BYTES + 1)) is None


def test_impossible_picture_sizes_and_missing_chunks_are_refused() -> None:
    data = chunk(b"IDAT", zlib.compress(bytes(7)))
    assert whole_png_size(png_of(2, 1, data)) == (2, 1)
    for width, height in ((0, 5), (1 << 14, 1 << 13), (2**32 - 1, 2**32 - 1)):
        assert whole_png_size(png_of(width, height, data)) is None
    assert whole_png_size(png_of(2, 1)) is None
    assert whole_png_size(PNG[:8] + data + chunk(b"IEND", b"")) is None
