"""Whole JPEGs are told from cut, half-written and foreign files, without decoding them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.pictures.whole_picture import is_whole_jpeg, whole_jpeg_size

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
