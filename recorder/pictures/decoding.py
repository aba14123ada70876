"""Decodes and scales untrusted pictures, and recognises whole ones."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from recorder.pictures.picture_size import PNG_START, decoding_problem, is_whole_jpeg

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
    """True for a picture that `decode_picture` decodes."""
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
