"""From a log's JPEG to what the network is shown: the crop, and the order of the loader's batches."""

from __future__ import annotations

import numpy as np
import pytest

from dataset import decode, preprocess
from dataset.preprocessing import Image
from tests.helpers.udacity import encode


def black() -> Image:
    return np.zeros((160, 320, 3), np.uint8)


def bilinear(place: int, source_px: int) -> list[float]:
    """How much of source pixel `place` is in each target pixel: pixel centres lie at halves, ends are repeated."""
    at = [min(max((i + 0.5) * source_px / 128 - 0.5, 0), source_px - 1) for i in range(128)]
    return [max(0.0, 1 - abs(x - place)) for x in at]


# Preprocessing


@pytest.mark.parametrize("row", [50, 51, 90, 138, 139])
def test_a_bright_row_is_where_the_crop_and_the_resize_put_it(row: int) -> None:
    picture = black()
    picture[row] = 255
    crop = preprocess(picture)
    assert crop.shape == (128, 128, 3)
    assert crop.dtype == np.uint8
    expected = 255 * np.array(bilinear(row - 50, source_px=90))
    assert expected.max() > 100
    np.testing.assert_allclose(crop[:, 64, 0], expected, atol=1)
    assert (crop == crop[:, :1]).all()


@pytest.mark.parametrize("column", [1, 160, 161, 318])
def test_a_bright_column_is_where_the_resize_puts_it(column: int) -> None:
    picture = black()
    picture[:, column] = 255
    crop = preprocess(picture)
    np.testing.assert_allclose(crop[64, :, 0], 255 * np.array(bilinear(column, source_px=320)), atol=1)
    assert crop.any()


def test_the_order_of_the_channels_is_kept() -> None:
    picture = black()
    picture[:] = (10, 100, 200)
    assert (preprocess(picture) == (10, 100, 200)).all()
    assert (decode(encode(picture, ".png")) == picture).all()


def test_a_larger_picture_shows_the_same_part_of_the_world() -> None:
    picture = np.zeros((320, 640, 3), np.uint8)
    picture[100:280] = 255
    assert (preprocess(picture) == 255).all()
    picture[100:280], picture[:100], picture[280:] = 0, 255, 255
    assert not preprocess(picture).any()


@pytest.mark.parametrize("data", [b"", b"no picture", b"\xff\xd8\xff\xe0 and no more"])
def test_what_is_no_picture_is_a_value_error(data: bytes) -> None:
    with pytest.raises(ValueError, match="picture"):
        decode(data)


def test_a_header_that_promises_too_many_pixels_is_no_picture() -> None:
    data = bytearray(encode(np.zeros((16, 16, 3), np.uint8)))
    size = data.index(b"\xff\xc0") + 5  # of the frame header: height and width, two bytes each
    data[size : size + 4] = (65500).to_bytes(2, "big") * 2
    with pytest.raises(ValueError, match="more than 67,108,864 pixels"):
        decode(bytes(data))
    longer = bytearray(encode(np.zeros((1, 16), np.uint8), ".png"))
    longer[16:20] = (1 << 21).to_bytes(4, "big")  # few pixels, but more columns than OpenCV allows
    with pytest.raises(ValueError, match="not a picture"):
        decode(bytes(longer))
