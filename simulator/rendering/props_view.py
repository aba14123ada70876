"""Draw the props into a picture: flat, upright, and hidden by nearer ground."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simulator.rendering.noise import Field
from simulator.rendering.props import SIZE_PX, Sprite, draw_sprites
from simulator.roads.centreline import Floats

NEAR_M, FAR_M = 1.5, 150.0
FADE_M = 30.0  # props fade in over this distance before FAR_M
MIN_SIZE_PX = 3.0


class PropsView:
    """The props of one world, (P, 5), from ``props.place_props``."""

    def __init__(self, props: Floats) -> None:
        self._props = props
        sprites = {kind: [_halvings(s) for s in variants] for kind, variants in draw_sprites().items()}
        variants = [sprites[int(kind)] for kind in props[:, 4]]
        self._sprites = [levels[k % len(levels)] for k, levels in enumerate(variants)]
        self._last_halving = np.array([len(levels) - 1 for levels in self._sprites])

    def draw(
        self,
        picture: NDArray[np.uint8],
        inverse: Field,
        eye_m: tuple[float, float, float],
        heading_rad: float,
        to_camera: Floats,
        focal_px: float,
    ) -> None:
        """Draw the props into a BGRA picture, far props first. ``inverse`` has 1 / distance ahead to the ground
        (1/m) for each pixel."""
        cos, sin = np.cos(heading_rad), np.sin(heading_rad)
        east, north, up = (self._props[:, :3] - eye_m).T
        ahead, left = east * cos + north * sin, north * cos - east * sin
        foot = to_camera @ np.stack([ahead, left, up])
        depth = np.maximum(foot[0], 1e-3)
        size_px = self._props[:, 3] * focal_px / depth
        height, width = inverse.shape
        column, row = width / 2 - focal_px * foot[1] / depth, height / 2 - focal_px * foot[2] / depth
        is_visible = (
            (ahead > NEAR_M)
            & (ahead < FAR_M)
            & (size_px > MIN_SIZE_PX)
            & (np.abs(column - width / 2) < width / 2 + size_px)
        )
        seen = np.flatnonzero(is_visible)[np.argsort(-ahead[is_visible], kind="stable")]
        ahead, size_px = ahead[seen], size_px[seen]
        halvings = np.clip(np.log2(SIZE_PX / size_px), 0, self._last_halving[seen]).astype(int)
        sprites = [self._sprites[k][halving] for k, halving in zip(seen.tolist(), halvings.tolist(), strict=True)]
        stamps = _Stamps(sprites, column[seen], row[seen], size_px, (width, height))
        strengths = (np.minimum(1.0, (FAR_M - ahead) / FADE_M) / 255.0).astype(np.float32)
        # Nearer ground hides a prop.
        free = inverse.ravel()[stamps.place] < (1 / ahead * 1.02)[stamps.sprite]
        colours = stamps.colours(np.bincount(stamps.sprite, free, len(sprites)) > 0)
        alpha = colours[:, 3] * free * strengths[stamps.sprite]
        _blend(picture.view(np.uint32).ravel(), stamps.place, colours.view(np.uint32).ravel(), alpha)


class _Stamps:
    """Sprites at their places in a picture. Their N pixels are ordered by sprite, then row by row."""

    def __init__(
        self, sprites: list[Sprite], column: Floats, foot: Floats, size_px: Floats, picture_px: tuple[int, int]
    ) -> None:
        """The foot of each sprite is at ``column`` and row ``foot``; its height is ``size_px``."""
        height, width = np.array([sprite.shape[:2] for sprite in sprites]).reshape(-1, 2).T
        scale = size_px / height
        left, top = column - width * scale / 2, foot - size_px
        x0, y0 = np.maximum(0, np.floor(left)).astype(int), np.maximum(0, np.floor(top)).astype(int)
        x1 = np.minimum(picture_px[0], np.ceil(left + width * scale)).astype(int)
        y1 = np.minimum(picture_px[1], np.ceil(foot)).astype(int)
        self._sprites = sprites
        self._columns, self._rows = np.maximum(0, x1 - x0), np.maximum(0, y1 - y0)
        # For sub-pixel placement: the sprite's coordinates at the centres of the picture's pixels.
        self._affine = np.zeros((len(sprites), 2, 3))
        self._affine[:, 0, 0] = self._affine[:, 1, 1] = 1 / scale
        self._affine[:, 0, 2] = (x0 + 0.5 - left) / scale - 0.5
        self._affine[:, 1, 2] = (y0 + 0.5 - top) / scale - 0.5
        sizes = self._columns * self._rows
        self._ends = np.cumsum(sizes)
        self.sprite = np.repeat(np.arange(len(sprites)), sizes)  # the number of each pixel's sprite
        within = np.arange(len(self.sprite)) - (self._ends - sizes)[self.sprite]
        row = within // self._columns[self.sprite]
        rest = (picture_px[0] - self._columns)[self.sprite]  # columns of the picture outside the sprite
        self.place = (y0 * picture_px[0] + x0)[self.sprite] + row * rest + within  # position in the flat picture

    def colours(self, is_shown: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """The pixels' colours, (N, 4) BGRA; 0 for sprites that are not shown."""
        colours = np.zeros((len(self.sprite), 4), np.uint8)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        columns, rows, ends = self._columns.tolist(), self._rows.tolist(), self._ends.tolist()
        for k in np.flatnonzero(is_shown).tolist():
            size = columns[k], rows[k]
            patch = colours[ends[k] - size[0] * size[1] : ends[k]].reshape(size[1], size[0], 4)
            cv2.warpAffine(self._sprites[k], self._affine[k], size, patch, flags, cv2.BORDER_CONSTANT)
        return colours


def _blend(
    picture: NDArray[np.uint32], pixels: NDArray[np.int64], colours: NDArray[np.uint32], alpha: Field
) -> None:
    """Blend colours (N,) over the pixels (N,) of a picture (P,); a BGRA colour is one word. If a pixel occurs
    twice, it is blended twice, in this order."""
    shown = np.flatnonzero(alpha)
    pixels, colours, alpha = pixels[shown], colours[shown], alpha[shown]
    earliest = np.empty(len(picture), np.intp)
    while len(pixels):
        # In each round, blend the first remaining colour of every pixel.
        count = np.arange(len(pixels))
        earliest[pixels[::-1]] = count[::-1]
        is_first = earliest[pixels] == count
        at = pixels[is_first]
        under = picture[at].view(np.uint8)
        blend = cv2.subtract(colours[is_first].view(np.uint8), under, dtype=cv2.CV_32F).ravel()
        blend *= np.repeat(alpha[is_first], 4)
        blend += under
        blend += np.float32(0.5)
        picture[at] = blend.astype(np.uint8).view(np.uint32)
        later = ~is_first
        pixels, colours, alpha = pixels[later], colours[later], alpha[later]


def _halvings(sprite: Sprite) -> list[Sprite]:
    """The sprite at 1, 1/2, 1/4, ... of its size, averaged with colours weighted by opacity, so that small sprites
    do not flicker."""
    levels = [sprite]
    alpha = sprite[..., 3:].astype(np.float32)
    weighted = np.dstack([sprite[..., :3] * alpha, alpha])
    while weighted.shape[0] > 8:
        weighted = cv2.resize(
            weighted, (max(1, weighted.shape[1] // 2), weighted.shape[0] // 2), interpolation=cv2.INTER_AREA
        )
        colour = weighted[..., :3] / np.maximum(weighted[..., 3:], 1e-3)
        levels.append(np.dstack([colour, weighted[..., 3:]]).astype(np.uint8))
    return levels
