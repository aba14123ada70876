"""The colours of the land, seen from above: one texel for each cell."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simulator.rendering.noise import Field, smooth_noise
from simulator.rendering.props import SUN
from simulator.rendering.terrain import CELL_M, Terrain, along_road, per_side, smoothstep
from simulator.roads.track import Track

# BGR, from published pictures of the lake and jungle of Udacity's simulator.
MEADOW, DRY_GRASS, SAND, EARTH = (42, 118, 128), (92, 158, 172), (112, 168, 196), (62, 112, 176)
JUNGLE_GRASS, JUNGLE_FLOOR, JUNGLE_ROCK, PALE_ROCK = (44, 92, 76), (26, 40, 34), (56, 70, 68), (118, 158, 172)
WATER = (168, 138, 96)


def paint_ground(
    track: Track, terrain: Terrain, light: NDArray[np.uint8], random: np.random.Generator
) -> NDArray[np.uint8]:
    """The land without the road: (rows, columns, 3) uint8 BGR, lit and shaded. ``light`` is the props' shadows."""
    shape = terrain.height_m.shape
    beyond, nearest = terrain.beyond_m, terrain.nearest
    jungle = along_road(track, np.array([float(look.jungle) for look in track.looks]), 15.0)[nearest]
    patches = smooth_noise(random, shape, 9.0 / CELL_M) + 0.6 * smooth_noise(random, shape, 2.5 / CELL_M)
    speckle = smooth_noise(random, shape, 0.9 / CELL_M)
    planes = [np.full(shape, channel, np.float32) for channel in MEADOW]

    def lay(colour: tuple[int, int, int], share: Field) -> None:
        for plane, channel in zip(planes, colour, strict=True):
            plane += share * (channel - plane)

    lay(DRY_GRASS, smoothstep(patches + 0.3))
    lay(JUNGLE_GRASS, jungle)
    lay(JUNGLE_FLOOR, jungle * smoothstep((beyond - 7.0 + 3.0 * patches) / 5.0))
    earth = per_side(track, nearest, terrain.offset_m, lambda edge: float(edge.kind == "dirt"))
    lay(EARTH, earth * (1.0 - smoothstep((beyond - 6.0 - 3.0 * patches) / 2.0)))
    rise_x = cv2.Sobel(terrain.height_m, cv2.CV_32F, 1, 0, scale=1 / (8 * CELL_M))
    rise_y = cv2.Sobel(terrain.height_m, cv2.CV_32F, 0, 1, scale=1 / (8 * CELL_M))
    steep = smoothstep((np.hypot(rise_x, rise_y) - 0.55) / 0.4)
    # Steep ground farther from the road is the top of a tree, not a cliff.
    near_cliff = steep * (1.0 - jungle * smoothstep((beyond - 8.0) / 4.0))
    lay(PALE_ROCK, near_cliff * (1.0 - jungle))
    lay(JUNGLE_ROCK, near_cliff * jungle)
    shore = terrain.height_m - terrain.water_level_m
    lay(SAND, (1.0 - smoothstep(shore / 0.7)) * (1.0 - jungle))
    wet = (shore < 0.03).astype(np.float32)

    sun = np.array(SUN) / np.linalg.norm(SUN)
    facing = (sun[2] - sun[0] * rise_x - sun[1] * rise_y) / np.sqrt(1.0 + rise_x**2 + rise_y**2)
    shading = (0.42 + 0.72 * np.clip(facing, 0.0, 1.2)) * (1.0 + 0.16 * speckle + 0.08 * patches)
    shading *= light.astype(np.float32) / 255.0 * exposure(track)[nearest]
    for plane in planes:
        plane *= shading
    lay(WATER, wet)
    return np.clip(np.stack(planes, axis=-1), 0, 255).astype(np.uint8)


def exposure(track: Track) -> Field:
    """The light at each point of the centre line, (N,); 1: full sun."""
    return along_road(track, np.array([look.light for look in track.looks]), 12.0)
