"""The size of a picture is read from its header; OpenCV is the judge."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
import pytest

from recorder.pictures.picture_size import SizeReader, width_and_height

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


def test_a_reader_of_many_gives_the_same_in_whatever_order_they_come() -> None:
    others = [b"", b"no picture", *(data[:20] for data in ENCODED.values())]
    for first, second in product([*ENCODED.values(), *others], repeat=2):
        reader = SizeReader()
        for data in (first, second, first, second):
            assert reader.width_and_height(data) == width_and_height(data)
