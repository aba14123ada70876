"""Decoding pictures that may be anything, and telling those that are whole: the one place that calls OpenCV's."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from recorder.pictures.jpeg import is_whole_jpeg
from recorder.pictures.picture_size import PNG_START, can_be_decoded

_REDUCED_GRAYSCALE_8: Final = 64
"""cv2.IMREAD_REDUCED_GRAYSCALE_8: a fraction of the time, and the whole picture is still read through."""


def decode_picture(picture: bytes, flags: int) -> NDArray[np.uint8] | None:
    """A JPEG or PNG as OpenCV decodes it with these flags (cv2.IMREAD_...), (height, width) or (height, width, 3).

    None for what is neither, has too many pixels or scans, or does not decode to its end. Wrong bytes within the
    coded picture that end where they should decode to a wrong picture: nothing distinguishes it from a right one.
    """
    if not can_be_decoded(picture):
        return None
    import cv2  # what looks at no picture needs none of its memory

    try:
        found = cv2.imdecode(np.frombuffer(picture, np.uint8), flags)
    except cv2.error:  # a header that promises more columns than OpenCV allows
        return None
    return None if found is None else found.astype(np.uint8, copy=False)


def decodes(picture: bytes) -> bool:
    """True for a picture that `decode_picture` decodes."""
    return decode_picture(picture, _REDUCED_GRAYSCALE_8) is not None


def is_whole_picture(picture: bytes) -> bool:
    """True for one complete JPEG or PNG that OpenCV decodes."""
    return decodes(picture) if picture.startswith(PNG_START) else is_whole_jpeg(picture)
