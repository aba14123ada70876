"""Alterations: what a filling copy's picture gets, so that the network never sees the same one twice.

What an alteration does is drawn first, from a random generator alone; it is then applied to a picture, (height,
width, 3) BGR uint8, and gives a new one. So whoever applies them elsewhere, as a GPU does, draws the very same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, Self

import cv2
import numpy as np

from dataset.errors import DatasetError
from dataset.preprocess import Image

Alteration = Literal["blur", "brightness", "shadow"]


@dataclass(frozen=True)
class Blur:
    """Gaussian blur with an odd kernel of 3 to 9 pixels."""

    kernel_px: int

    @classmethod
    def draw(cls, random: np.random.Generator, height: int, width: int) -> Self:
        return cls(2 * int(random.integers(1, 5)) + 1)

    def apply(self, picture: Image) -> Image:
        blurred = cv2.GaussianBlur(picture, (self.kernel_px, self.kernel_px), 0)
        return blurred.astype(np.uint8, copy=False)


@dataclass(frozen=True)
class Brightness:
    """The value channel of HSV times 0.4 to 1.6, so that pictures become darker as often as brighter."""

    factor: float

    @classmethod
    def draw(cls, random: np.random.Generator, height: int, width: int) -> Self:
        return cls(random.uniform(0.4, 1.6))

    def apply(self, picture: Image) -> Image:
        hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
        hsv[:, :, 2] = cv2.convertScaleAbs(hsv[:, :, 2], alpha=self.factor)
        return cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR).astype(np.uint8, copy=False)


@dataclass(frozen=True)
class Shadow:
    """One to five polygons of three to six corners, in which the picture keeps 0.45 to 0.74 of its light."""

    mask: Image  # (height, width), not 0 in the shadow
    factor: float

    @classmethod
    def draw(cls, random: np.random.Generator, height: int, width: int) -> Self:
        mask = np.zeros((height, width), dtype=np.uint8)
        for _ in range(int(random.integers(1, 6))):
            corners = random.integers((0, 0), (width, height), size=(int(random.integers(3, 7)), 2))
            cv2.fillPoly(mask, [corners.astype(np.int32)], 255)
        return cls(mask, random.uniform(0.45, 0.74))

    def apply(self, picture: Image) -> Image:
        darker = cv2.convertScaleAbs(picture, alpha=self.factor)
        return np.where(self.mask[:, :, None] > 0, darker, picture).astype(np.uint8, copy=False)


ALTERATIONS: Final[dict[str, type[Blur | Brightness | Shadow]]] = {
    "blur": Blur,
    "brightness": Brightness,
    "shadow": Shadow,
}


def draw(names: str, seed: int, height: int, width: int) -> list[Blur | Brightness | Shadow]:
    """The alterations called `names` ("blur+shadow"; "" for none) for a picture of this size, in their order,
    drawn from `seed` (not negative).

    Raises DatasetError for a name or a seed that no index of ours has, and for a name that comes twice.
    """
    wanted = names.split("+") if names else []
    if seed < 0 or not set(wanted) <= ALTERATIONS.keys() or len(set(wanted)) < len(wanted):
        raise DatasetError(f"{names!r} with seed {seed} is no alteration; build the index again with `bc-index`")
    random = np.random.default_rng(seed)
    return [ALTERATIONS[name].draw(random, height, width) for name in wanted]


def alter(picture: Image, names: str, seed: int) -> Image:
    """Apply the alterations that `draw` gives for these names and this seed; it raises what `draw` raises."""
    for alteration in draw(names, seed, *picture.shape[:2]):
        picture = alteration.apply(picture)
    return picture
