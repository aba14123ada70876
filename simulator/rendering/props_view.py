"""Draws the props into a picture: flat, upright, hidden by the ground where it is nearer."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from simulator.rendering.noise import Field
from simulator.rendering.props import SIZE_PX, Sprite, draw_sprites
from simulator.roads.road_stretches import Floats

NEAR_M, FAR_M = 1.5, 150.0
FADE_M = 30.0  # before FAR_M, over which they appear
SMALLEST_PX = 3.0


class PropsView:
    """The props of one world: (P, 5) as placed by ``props.place_props``."""

    def __init__(self, props: Floats) -> None:
        self._props = props
        self._sprites = {kind: [_halvings(s) for s in variants] for kind, variants in draw_sprites().items()}

    def draw(
        self,
        picture: NDArray[np.uint8],
        inverse: Field,
        eye_m: tuple[float, float, float],
        heading_rad: float,
        to_camera: Floats,
        focal_px: float,
    ) -> None:
        """Draw, far ones first, into a picture whose ground is at the given inverse forward distances (1/m)."""
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
            & (size_px > SMALLEST_PX)
            & (np.abs(column - width / 2) < width / 2 + size_px)
        )
        seen = np.flatnonzero(is_visible)[np.argsort(-ahead[is_visible], kind="stable")]
        ahead, size_px = ahead[seen], size_px[seen]
        halvings = np.log2(SIZE_PX / size_px)
        strengths = np.minimum(1.0, (FAR_M - ahead) / FADE_M) / 255.0
        for k, kind, *place, halving, hidden, strength in zip(
            seen.tolist(),
            self._props[seen, 4].tolist(),
            column[seen].tolist(),
            row[seen].tolist(),
            size_px.tolist(),
            halvings.tolist(),
            1 / ahead * 1.02,
            strengths.astype(np.float32),
            strict=True,
        ):
            variants = self._sprites[int(kind)]
            levels = variants[k % len(variants)]
            sprite = levels[int(min(max(halving, 0), len(levels) - 1))]
            _stamp(picture, inverse, sprite, place, hidden, strength)


def _halvings(sprite: Sprite) -> list[Sprite]:
    """The sprite and its averaged halvings, colours weighted by opacity, so that scaling down does not flicker."""
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


def _stamp(
    picture: NDArray[np.uint8],
    inverse: Field,
    sprite: Sprite,
    place: list[float],
    hidden: np.float64,
    strength: np.float32,
) -> None:
    """Blend one sprite in; ``place`` is its foot's column and row and its height, in pixels. Ground whose inverse
    distance is ``hidden`` or more stands before it."""
    column, foot, size = place
    scale = size / sprite.shape[0]
    left, top = column - sprite.shape[1] * scale / 2, foot - size
    x0, x1 = max(0, math.floor(left)), min(picture.shape[1], math.ceil(left + sprite.shape[1] * scale))
    y0, y1 = max(0, math.floor(top)), min(picture.shape[0], math.ceil(foot))
    if x0 >= x1 or y0 >= y1:
        return
    free = inverse[y0:y1, x0:x1] < hidden
    if not np.count_nonzero(free):
        return
    # Sub-pixel placement: sprite coordinates of the target's pixel centres.
    affine = np.array(
        [[1 / scale, 0.0, (x0 + 0.5 - left) / scale - 0.5], [0.0, 1 / scale, (y0 + 0.5 - top) / scale - 0.5]]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    patch = cv2.warpAffine(sprite, affine, (x1 - x0, y1 - y0), flags=flags, borderMode=cv2.BORDER_CONSTANT)
    alpha = patch[..., 3] * free * strength
    target = picture[y0:y1, x0:x1]
    # A broadcast over three channels would cost more than all else here.
    blend = cv2.subtract(cv2.cvtColor(patch, cv2.COLOR_BGRA2BGR), target, dtype=cv2.CV_32F)
    blend = blend * cv2.cvtColor(alpha, cv2.COLOR_GRAY2BGR) + target
    np.add(blend, np.float32(0.5), out=target, casting="unsafe")
