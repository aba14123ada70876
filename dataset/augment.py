"""Alterations of the copies that fill a steering bin, so that the network does not see the same picture twice.

Each function takes a picture, (height, width, 3) BGR uint8, and returns a new one. The strength is random.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np

from dataset.errors import DatasetError
from dataset.preprocessing import Image


def blur(picture: Image, random: np.random.Generator) -> Image:
    """Gaussian blur with an odd kernel of 3 to 9 pixels."""
    kernel_px = 2 * int(random.integers(1, 5)) + 1
    return cv2.GaussianBlur(picture, (kernel_px, kernel_px), 0).astype(np.uint8, copy=False)


def brightness(picture: Image, random: np.random.Generator) -> Image:
    """Multiply the value channel of HSV by 0.4 to 1.6: pictures become darker as often as brighter."""
    hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
    hsv[:, :, 2] = cv2.convertScaleAbs(hsv[:, :, 2], alpha=random.uniform(0.4, 1.6))
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR).astype(np.uint8, copy=False)


def shadow(picture: Image, random: np.random.Generator) -> Image:
    """Darken one to five polygons of three to six corners to 0.45 to 0.74 of their brightness."""
    height, width = picture.shape[:2]
    mask = np.zeros((height, width), np.uint8)
    for _ in range(int(random.integers(1, 6))):
        corners = random.integers((0, 0), (width, height), size=(int(random.integers(3, 7)), 2))
        cv2.fillPoly(mask, [corners.astype(np.int32)], 255)
    darker = cv2.convertScaleAbs(picture, alpha=random.uniform(0.45, 0.74))
    return np.where(mask[:, :, None] > 0, darker, picture).astype(np.uint8, copy=False)


ALTERATIONS: Final[dict[str, Callable[[Image, np.random.Generator], Image]]] = {
    "blur": blur,
    "brightness": brightness,
    "shadow": shadow,
}


def alter(picture: Image, names: str, seed: int) -> Image:
    """Apply the alterations `names` ("blur+shadow"; "" for none) in this order, with the random generator `seed`.

    Raises DatasetError for an unknown or repeated name, or a negative seed.
    """
    wanted = names.split("+") if names else []
    if seed < 0 or not ALTERATIONS.keys() >= set(wanted) or len(set(wanted)) < len(wanted):
        raise DatasetError(
            f"{names!r} with seed {seed} is not an alteration; build the index again with `bc-index`"
        )
    random = np.random.default_rng(seed)
    for name in wanted:
        picture = ALTERATIONS[name](picture, random)
    return picture
