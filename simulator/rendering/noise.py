"""Smooth random fields and tileable textures. The same state of the random generator gives the same result."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

# Always single precision; numpy's own types lose the precision in mixed arithmetic.
Field = NDArray[np.floating[Any]]


def smooth_noise(random: np.random.Generator, shape: tuple[int, int], feature_px: float) -> Field:
    """A random field (rows, columns) float32 in about -1..1, with bumps of about ``feature_px`` cells."""
    rows, columns = (max(2, round(n / feature_px) + 2) for n in shape)
    coarse = random.uniform(-1.0, 1.0, (rows, columns)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC), dtype=np.float32)


def _tileable_noise(random: np.random.Generator, feature_px: int) -> Field:
    """Noise (512, 512) float32 in about -1..1, which can be tiled without seams."""
    cells = 512 // feature_px
    wrapped = np.pad(random.uniform(-1.0, 1.0, (cells, cells)).astype(np.float32), 2, mode="wrap")
    large = cv2.resize(wrapped, None, fx=feature_px, fy=feature_px, interpolation=cv2.INTER_CUBIC)
    inside = slice(2 * feature_px, 2 * feature_px + 512)
    return np.asarray(large[inside, inside], dtype=np.float32)


def grain_tile(random: np.random.Generator) -> NDArray[np.uint8]:
    """The grain of asphalt, earth and grass: (512, 512) uint8, mean 128."""
    grain = 34.0 * random.normal(size=(512, 512)).astype(np.float32)
    grain += 26.0 * _tileable_noise(random, 4) + 26.0 * _tileable_noise(random, 16)
    return _levels(grain)


def cobble_tile(random: np.random.Generator) -> NDArray[np.uint8]:
    """Cobblestones with dark joints: (512, 512) uint8, mean 128, about 20 stones across."""
    stones = 20
    at = np.stack(np.meshgrid(np.arange(stones), np.arange(stones)), -1) + random.uniform(
        0.15, 0.85, (stones, stones, 2)
    )
    pixels = np.round(at.reshape(-1, 2) * 512 / stones).astype(np.intp) % 512
    seeds = np.full((512, 512), 255, np.uint8)
    seeds[pixels[:, 1], pixels[:, 0]] = 0
    seeds = np.pad(seeds, 64, mode="wrap")
    _, labels = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    # A stone that the padding repeats has two labels: its shade must depend on its place, not on its label.
    rows, columns = np.nonzero(seeds == 0)
    shade = np.zeros(labels.max() + 1, np.float32)
    shade[labels[rows, columns]] = random.uniform(-22.0, 22.0, (512, 512))[rows % 512 - 64, columns % 512 - 64]
    flat = shade[labels]
    joints = cv2.dilate(
        cv2.morphologyEx(labels.astype(np.float32), cv2.MORPH_GRADIENT, np.ones((3, 3))), np.ones((2, 2))
    )
    flat[joints > 0] = -70.0
    flat = np.asarray(cv2.GaussianBlur(flat, (0, 0), 1.2), dtype=np.float32)[64:-64, 64:-64]
    return _levels(flat + 10.0 * random.normal(size=flat.shape).astype(np.float32))


def _levels(values: Field) -> NDArray[np.uint8]:
    return np.asarray(np.clip(values - values.mean() + 128.0, 0, 255), dtype=np.uint8)
