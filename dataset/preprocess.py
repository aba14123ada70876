"""From the simulator's picture to what the network sees: one function for training, driving and viewing."""

from __future__ import annotations

import contextlib
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.errors import counted
from recorder.pictures.picture_size import MOST_PIXELS, pixels

Image = NDArray[np.uint8]

SIZE_PX: Final = 128
CROP_SHAPE: Final = (SIZE_PX, SIZE_PX, 3)
CROP_BYTES: Final = SIZE_PX * SIZE_PX * 3
# Of a picture 160 rows high, 50 are cut off the top (sky, trees) and 20 off the bottom (the bonnet).
TOP_SHARE: Final = 50 / 160
BOTTOM_SHARE: Final = 20 / 160

DESCRIPTION: Final = {
    "channels": "BGR",
    "crop_top": "50/160",
    "crop_bottom": "20/160",
    "height_px": str(SIZE_PX),
    "width_px": str(SIZE_PX),
    "resize": "bilinear",
}
"""The preprocessing in words, stored with every run and every drive."""


def decode(encoded: bytes, size: int | None = None) -> Image:
    """A JPEG or PNG as (height, width, 3) BGR uint8. Raises ValueError if it is none, or would fill the memory.

    `size` is its number of pixels by its header, where that is known already.
    """
    if not encoded:
        raise ValueError("empty picture")
    size = (pixels(encoded) or 0) if size is None else size
    if size > MOST_PIXELS:
        raise ValueError(f"a picture of more than {MOST_PIXELS:,} pixels")
    picture = None
    with contextlib.suppress(cv2.error):  # a header that promises more columns than OpenCV allows
        if size:
            picture = cv2.imdecode(np.frombuffer(encoded, dtype=np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError(f"{counted(len(encoded), 'byte')} that are not a picture")
    return picture.astype(np.uint8, copy=False)


def is_crop(encoded: bytes) -> bool:
    """True for the header of a JPEG or PNG of as many pixels as the network sees; nothing is unpacked."""
    return pixels(encoded) == SIZE_PX**2


def seen_rows(height: int) -> slice:
    """The rows of a picture so high that the network sees."""
    return slice(round(height * TOP_SHARE), height - round(height * BOTTOM_SHARE))


def preprocess(picture: Image) -> Image:
    """A camera picture (height, width, 3) BGR uint8 as the network's input, (128, 128, 3) BGR uint8.

    The crop is a share of the height, so that pictures of another size show the same part of the world.
    """
    resized = cv2.resize(picture[seen_rows(picture.shape[0])], (SIZE_PX, SIZE_PX), interpolation=cv2.INTER_LINEAR)
    return resized.astype(np.uint8, copy=False)
