"""Scaling pictures of any shape: one column of 60,000 pixels would become gigabytes."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

MIN_ROWS: Final = 2
MAX_HEIGHT: Final = 4
"""Times its width."""


def scaled_to_width(picture: NDArray[np.uint8], width_px: int) -> NDArray[np.uint8] | None:
    """A picture (height, width) of at least one row as one of this width; None if that has fewer than `MIN_ROWS`
    rows, or is more than `MAX_HEIGHT` times as high as it is wide."""
    height, width = picture.shape
    height_px = round(height * width_px / width)
    if not MIN_ROWS <= height_px <= MAX_HEIGHT * width_px:
        return None
    scaled = cv2.resize(picture, (width_px, height_px), interpolation=cv2.INTER_AREA)
    return scaled.astype(np.uint8, copy=False)
