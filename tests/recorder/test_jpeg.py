"""Whole JPEGs are told from cut, half-written and foreign files, without decoding them."""

from __future__ import annotations

import struct
import zlib
from functools import cache
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dataset import decode
from recorder.pictures.picture_size import (
    PADDING_BYTES,
    decode_picture,
    is_whole_jpeg,
    whole_jpeg_size,
    whole_png_size,
    width_and_height,
)

ENCODINGS: dict[str, list[int]] = {
    "baseline": [],
    "progressive": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
    "own tables": [cv2.IMWRITE_JPEG_OPTIMIZE, 1],
    "restarts": [cv2.IMWRITE_JPEG_RST_INTERVAL, 3],
    "4:1:1, progressive": [
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411,
        cv2.IMWRITE_JPEG_PROGRESSIVE,
        1,
    ],
}


@cache
def encoded(encoding: str, is_grey: bool) -> bytes:
    """A small picture with edges, a gradient and noise."""
    picture = np.random.default_rng(1).integers(0, 60, (40, 56, 3)).astype(np.uint8)
    picture[:, :, 1] += np.linspace(0, 150, 56).astype(np.uint8)
    cv2.circle(picture, (28, 20), 12, (30, 200, 250), -1)
    ok, data = cv2.imencode(".jpg", picture[:, :, 1] if is_grey else picture, ENCODINGS[encoding])
    assert ok
    return data.tobytes()


whole_pictures = st.builds(encoded, st.sampled_from(sorted(ENCODINGS)), st.booleans())


@pytest.mark.parametrize("is_grey", [False, True], ids=["colour", "grey"])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_common_encoding_is_taken(encoding: str, is_grey: bool) -> None:
    assert is_whole_jpeg(encoded(encoding, is_grey))
    assert whole_jpeg_size(encoded(encoding, is_grey)) == (56, 40)


def test_pictures_of_real_recordings_are_taken(recordings: Path) -> None:
    """Every twentieth: tests/test_real_recordings.py imports all of two recordings."""
    pictures = sorted(recordings.glob("*/IMG/*.jpg"))[::20]
    assert len(pictures) > 400
    assert [path.name for path in pictures if not is_whole_jpeg(path.read_bytes())] == []


@given(whole_pictures, st.data())
def test_a_picture_that_is_cut_off_anywhere_is_refused(data: bytes, draw: st.DataObject) -> None:
    assert not is_whole_jpeg(data[: draw.draw(st.integers(0, len(data) - 1))])


@given(whole_pictures, st.data())
def test_a_picture_whose_end_is_not_written_yet_is_refused(data: bytes, draw: st.DataObject) -> None:
    """Its file already has its size, but zeros where the rest will be."""
    kept = draw.draw(st.integers(0, len(data) - 2))
    assert not is_whole_jpeg(data[:kept] + bytes(len(data) - kept))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff\xd8",
        b"\xff\xd8\xff\xd9",
        b"\xff\xd8\xff" + bytes(500) + b"\xff\xd9",
        b"\xff\xd8" + b"\xff" * 500 + b"\xd9",
        b"GIF89a" + bytes(100),
        b"\x89PNG\r\n\x1a\n" + bytes(100),
    ],
)
def test_what_only_looks_like_a_jpeg_is_refused(data: bytes) -> None:
    assert not is_whole_jpeg(data)


def test_what_lies_behind_the_end_does_not_matter() -> None:
    data = encoded("baseline", False)
    assert is_whole_jpeg(data + bytes(700))
    assert is_whole_jpeg(data + data[:-200])


@pytest.mark.parametrize("marker", [b"\xff\xc0", b"\xff\xda"], ids=["SOF", "SOS"])
def test_a_picture_without_its_frame_or_its_scan_is_refused(marker: bytes) -> None:
    data = encoded("baseline", True)
    begin = data.index(marker)
    end = begin + 2 + int.from_bytes(data[begin + 2 : begin + 4], "big")
    assert not is_whole_jpeg(data[:begin] + data[end:])


def test_a_picture_of_thousands_of_scans_is_refused() -> None:
    """Each makes OpenCV go over the whole picture once more, and takes fourteen bytes."""
    assert is_whole_jpeg(of_scans(0))
    assert is_whole_jpeg(of_scans(50))
    assert not is_whole_jpeg(of_scans(2000))


def of_scans(count: int) -> bytes:
    """A progressive JPEG whose last scan is there so many times more."""
    data = cv2.imencode(".jpg", np.zeros((64, 64, 3), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    return data[:-2] + count * data[data.rindex(b"\xff\xda") : -2] + data[-2:]


def test_nothing_decodes_a_picture_of_thousands_of_scans() -> None:
    coded = np.frombuffer(of_scans(2000), np.uint8)
    assert cv2.imdecode(coded, cv2.IMREAD_COLOR) is not None  # OpenCV itself; a larger one takes seconds
    assert decode_picture(of_scans(50), cv2.IMREAD_COLOR) is not None
    assert decode(of_scans(50)).shape == (64, 64, 3)
    assert decode_picture(of_scans(2000), cv2.IMREAD_COLOR) is None
    with pytest.raises(ValueError, match="more than 100 scans"):
        decode(of_scans(2000))


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


SIZES = [(320, 160), (160, 320), (321, 160), (8, 2000)]


def picture(width: int, height: int, ending: str, *options: int) -> bytes:
    noise = np.random.default_rng(width).integers(0, 255, (height, width, 3)).astype(np.uint8)
    ok, data = cv2.imencode(ending, noise, options)
    assert ok
    return data.tobytes()


ENCODED = {
    **{f"{ending} {size}": picture(*size, ending) for size, ending in product(SIZES, (".jpg", ".png"))},
    "own tables": picture(320, 160, ".jpg", cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    "progressive": picture(320, 160, ".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "quality": picture(64, 48, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 30),
}


@pytest.mark.parametrize("data", ENCODED.values(), ids=ENCODED)
def test_it_is_that_of_the_picture_when_it_is_decoded(data: bytes) -> None:
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    height, width, _ = decoded.shape
    assert width_and_height(data) == (width, height)
