"""A painted world that any camera can be put into: a level road, and hills infinitely far away.

A pixel's colour is a function of where its line of sight meets the road, or of its direction; computed pixel by
pixel, from the camera's place and angles, without homographies.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from recorder.log.session_car import Car


def render(
    geometry: Car,
    x_m: float = 0.0,
    left_m: float = 0.0,
    turn_rad: float = 0.0,
    beside_m: float = 0.0,
    width_px: int = 320,
    height_px: int = 160,
) -> NDArray[np.uint8]:
    """The picture (height, width, 3) of a camera `beside_m` to the left of the middle of a car whose rear axle is
    at (`x_m`, `left_m`) on the road, and which is turned to the left."""
    focal_px = geometry.focal * height_px
    down_rad = math.atan((height_px / 2 - geometry.horizon * height_px) / focal_px)
    right = (np.arange(width_px)[None, :] + 0.5 - width_px / 2) / focal_px
    below = (np.arange(height_px)[:, None] + 0.5 - height_px / 2) / focal_px
    # of each line of sight, for a metre along the camera's axis: ahead, to the left, down
    ahead = math.cos(down_rad) - below * math.sin(down_rad) + 0 * right
    down = math.sin(down_rad) + below * math.cos(down_rad) + 0 * right
    left = -right + 0 * below
    east = ahead * math.cos(turn_rad) - left * math.sin(turn_rad)
    north = ahead * math.sin(turn_rad) + left * math.cos(turn_rad)
    eye_x = x_m + geometry.forward_m * math.cos(turn_rad) - beside_m * math.sin(turn_rad)
    eye_y = left_m + geometry.forward_m * math.sin(turn_rad) + beside_m * math.cos(turn_rad)
    is_road = down > 0
    metres = geometry.height_m / np.where(is_road, down, 1.0)
    road = _paint(eye_x + metres * east, eye_y + metres * north)
    sky = _paint(12 * np.arctan2(north, east), 30 * down / np.hypot(east, north))
    # far away the road's pattern is finer than pixels: it fades into grey
    fade = np.exp(-metres / 5.0)[..., None]
    picture = np.where(is_road[..., None], fade * road + (1 - fade) * 128, sky)
    return picture.round().astype(np.uint8)


def _paint(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) colours that change slowly over some metres, nowhere the same."""
    waves = (np.sin(1.1 * x) + np.cos(1.7 * y), np.sin(0.9 * y + 0.4 * x) * 2, np.cos(0.7 * x - 1.3 * y) * 2)
    return np.stack([128 + 50 * wave for wave in waves], axis=-1)
