"""The sky and the far hills: a panorama at infinite distance, which turns with the heading."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH_PX, HEIGHT_PX = 2048, 256  # 360 degrees; from TOP to BOTTOM, which are tangents of the elevation
TOP, BOTTOM = 0.9, -0.1
HAZE = (200, 184, 166)  # BGR at the horizon
BLUE = (178, 122, 84)  # BGR overhead


def paint_sky(random: np.random.Generator, jungle: float) -> NDArray[np.uint8]:
    """The panorama, (HEIGHT_PX, WIDTH_PX, 3) uint8 BGR. The columns are azimuths, counter-clockwise from east.

    ``jungle`` (0..1) makes the hills higher, nearer and darker.
    """
    tangent = np.linspace(TOP, BOTTOM, HEIGHT_PX)[:, None, None]
    up = np.clip(tangent / 0.45, 0.0, 1.0) ** 0.7
    sky = np.array(HAZE) + up * (np.array(BLUE, dtype=np.float64) - HAZE) + np.zeros((1, WIDTH_PX, 1))
    azimuth = np.linspace(0.0, 2 * np.pi, WIDTH_PX, endpoint=False)
    bare, wooded = np.array([118.0, 140, 136]), np.array([46.0, 58, 50])
    for layer, (height, distance) in enumerate(((0.10, 0.55), (0.055, 0.25))):
        waves = range(3, 120, 4 - layer)
        ridge = sum(
            np.cos(k * azimuth + random.uniform(0, 6.28)) * random.uniform(0.2, 1.0) / k**0.8 for k in waves
        )
        top = height * (1.0 + 0.8 * jungle) * (0.55 + 0.28 * np.asarray(ridge))
        colour = bare + jungle * (wooded - bare)
        colour = colour + (np.array(HAZE) - colour) * distance * (1.0 - 0.5 * jungle)
        texture = 1.0 + 0.12 * random.normal(size=(HEIGHT_PX, WIDTH_PX, 1))
        cover = np.clip((top[None, :, None] - tangent) * HEIGHT_PX / (TOP - BOTTOM) + 0.5, 0.0, 1.0)
        sky += cover * (colour * texture - sky)
    return np.asarray(cv2.blur(np.clip(sky, 0, 255).astype(np.uint8), (3, 1)), dtype=np.uint8)
