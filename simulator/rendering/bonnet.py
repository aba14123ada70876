"""The car's bonnet at the bottom of each camera's picture, as in recordings of Udacity's simulator."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

TOP_PX = 132  # the first row with the bonnet
PAINT, SHADE, GLOSS = (126, 138, 136), (60, 66, 66), (184, 194, 194)  # BGR


def draw_bonnet(camera: str, width_px: int, height_px: int) -> NDArray[np.uint8]:
    """The lowest rows, from ``TOP_PX`` on: (height - TOP_PX, width, 4) uint8 BGRA, transparent outside the
    bonnet."""
    fine = 4
    x = np.arange(width_px * fine) / fine
    if camera == "center":
        edge = 137.0 + 22.0 * (np.abs(x - 164.0) / 84.0) ** 2.6
    else:
        inner = x - 184.0 if camera == "left" else 122.0 - x  # distance from the bonnet's corner
        edge = np.where(inner > 0, 138.5 + 20.0 * np.exp(-np.maximum(inner, 0) / 9.0), 200.0)
    layer = np.zeros(((height_px - TOP_PX) * fine, width_px * fine, 4), np.float32)
    y = (TOP_PX + np.arange(layer.shape[0]) / fine)[:, None]
    depth = y - edge[None, :]
    shine = np.clip(1.0 - np.abs(depth - 3.0) / 3.0, 0.0, 1.0)[..., None]
    dull = np.clip((depth - 5.0) / 14.0, 0.0, 0.55)[..., None]
    colour = np.array(PAINT) + shine * (np.array(GLOSS) - PAINT)
    layer[..., :3] = colour + dull * (np.array(SHADE) - colour)
    layer[..., 3] = 255.0 * (depth > 0)
    rim = (depth > 0) & (depth < 0.8)
    layer[..., :3][rim] = SHADE
    small = cv2.resize(layer, (width_px, height_px - TOP_PX), interpolation=cv2.INTER_AREA)
    return np.clip(small, 0, 255).astype(np.uint8)
