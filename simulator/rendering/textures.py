"""The colours of the land, seen from above, and of the road, unrolled: a picture over (distance from the centre
line, arc length).

Lines, kerbs and stones are painted with texels of 5 cm across and 25 cm along the road, so that they are sharper
than the land's cells. Blurred copies for larger distances are next to it, so that thin lines do not flicker.
"""

from __future__ import annotations

import itertools

import cv2
import numpy as np
from numpy.typing import NDArray

from simulator.rendering.noise import Field, smooth_noise
from simulator.rendering.props import SUN
from simulator.rendering.terrain import CELL_M, PARAPET_M, Terrain, along_road, per_side, smoothstep
from simulator.roads.road_stretches import Edge, Look
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


ACROSS_M, ALONG_M = 0.05, 0.25  # one texel
REACH_M = 9.0  # distance from the centre line that is painted; beyond it, the land's colours are used
COLUMNS = round(2 * REACH_M / ACROSS_M)
LEVELS = 4  # including the blurred copies; level n is for pixels that cover 2**n texels
DASH_PERIOD_M, DASH_M = 6.0, 3.0

# BGR
TAR = {"asphalt": (102, 107, 108), "worn": (122, 130, 132), "cobbles": (128, 140, 156)}
JUNGLE_TAR = {"asphalt": (116, 118, 122), "worn": (100, 106, 112), "cobbles": (128, 140, 156)}
WHITE, YELLOW, CONCRETE, RED = (222, 224, 224), (52, 176, 202), (178, 190, 192), (104, 112, 208)
GREY_KERB, PACKED_EARTH, PARAPET = (150, 146, 132), (116, 158, 190), (24, 22, 22)


def paint_road(
    track: Track,
    terrain: Terrain,
    ground: NDArray[np.uint8],
    light: NDArray[np.uint8],
    random: np.random.Generator,
) -> NDArray[np.uint8]:
    """The texture (rows, LEVELS * COLUMNS, 4) uint8: BGR, and the share of cobblestones (0..255).

    Row r is at arc length r * length / rows. Column c of level 0 is ``(c + 0.5) * ACROSS_M - REACH_M`` to the left
    of the centre line.
    """
    line = track.line
    rows = round(line.length_m / ALONG_M)
    point = np.arange(rows) * len(line.points_m) / rows
    offset = ((np.arange(COLUMNS) + 0.5) * ACROSS_M - REACH_M).astype(np.float32)
    x, y = _places(track, point, offset, terrain.origin_m)
    colour = cv2.remap(ground, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    bright = cv2.remap(light, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32) / 255.0
    nearest = point.astype(np.intp)
    bright *= exposure(track)[nearest][:, None]
    wear = 1.0 + 0.05 * smooth_noise(random, (rows, COLUMNS), 24) + 0.05 * smooth_noise(random, (rows, COLUMNS), 6)
    cobbles = np.zeros((rows, COLUMNS), np.float32)
    half_width = track.half_width_m.astype(np.float32)[nearest][:, None]
    beyond = np.abs(offset)[None, :] - half_width
    dash = (np.arange(rows) * line.length_m / rows) % (
        line.length_m / round(line.length_m / DASH_PERIOD_M)
    ) < DASH_M
    stripes = (np.arange(rows) * line.length_m / rows / 1.25).astype(int) % 2 == 0

    for look_number, start, stop in _runs(track.look_index[nearest]):
        look = track.looks[look_number]
        at = slice(start, stop)
        lit = bright[at] * wear[at]
        _lay_tar(colour[at], cobbles[at], look, offset, beyond[at], lit)
        if look.dashed:
            _lay(colour[at], _band(np.abs(offset), -0.09, 0.09)[None, :] * dash[at, None], WHITE, lit)
        for edge, side in ((look.right, slice(0, COLUMNS // 2)), (look.left, slice(COLUMNS // 2, COLUMNS))):
            _lay_edge(colour[at, side], edge, beyond[at, side], stripes[at], lit[:, side])

    base = np.dstack([np.clip(colour, 0, 255), 255.0 * cobbles]).astype(np.uint8)
    return np.hstack([base, *(_blurred(base, level) for level in range(1, LEVELS))])


def _places(
    track: Track, point: NDArray[np.float64], offset: Field, origin_m: tuple[float, float]
) -> tuple[Field, Field]:
    """The coordinates (column, row) of every texel in the land's cells."""
    line, count = track.line, np.arange(len(track.line.points_m) + 1)
    closed = np.vstack([line.points_m, line.points_m[:1]])
    heading = np.unwrap(np.append(line.heading_rad, line.heading_rad[0]))
    angle = np.interp(point, count, heading)[:, None]
    x = np.interp(point, count, closed[:, 0])[:, None] - offset * np.sin(angle)
    y = np.interp(point, count, closed[:, 1])[:, None] + offset * np.cos(angle)
    return ((x - origin_m[0]) / CELL_M).astype(np.float32), ((y - origin_m[1]) / CELL_M).astype(np.float32)


def _runs(labels: NDArray[np.intp]) -> list[tuple[int, int, int]]:
    """(label, start, stop) of each stretch of equal labels."""
    cuts = [0, *(np.flatnonzero(np.diff(labels)) + 1).tolist(), len(labels)]
    return [(int(labels[a]), a, b) for a, b in itertools.pairwise(cuts)]


def _band(distance: Field, start_m: float, stop_m: float) -> Field:
    """1 between two distances, 0 outside, with soft edges of one texel."""
    inside = np.minimum(distance - start_m, stop_m - distance) / ACROSS_M + 0.5
    return np.asarray(np.clip(inside, 0.0, 1.0), dtype=np.float32)


def _lay(colour: Field, share: Field, paint: tuple[int, int, int], lit: Field) -> None:
    for channel in range(3):
        plane = colour[..., channel]
        plane += share * (paint[channel] * lit - plane)


def _lay_tar(colour: Field, cobbles: Field, look: Look, offset: Field, beyond: Field, lit: Field) -> None:
    cover = np.clip(0.5 - beyond / ACROSS_M, 0.0, 1.0)
    lanes = 1.9 if look.dashed else 0.0
    wheels = np.exp(-(((np.abs(np.abs(offset) - lanes) - 0.75) / 0.4) ** 2))  # polished by the wheels
    tar = (JUNGLE_TAR if look.jungle else TAR)[look.surface]
    _lay(colour, cover, tar, lit * (1.0 - 0.07 * wheels))
    if look.surface == "cobbles":
        cobbles[...] = cover


def _lay_edge(colour: Field, edge: Edge, beyond: Field, stripes: NDArray[np.bool_], lit: Field) -> None:
    if edge.kind == "kerb":
        _lay(colour, _band(beyond, -0.85, -0.73) + _band(beyond, -0.45, -0.33), YELLOW, lit)
        _lay(colour, _band(beyond, 0.0, 0.9), GREY_KERB, lit)
        _lay(colour, _band(beyond, 0.9, 1.9), CONCRETE, lit)
    elif edge.kind == "striped":
        _lay(colour, _band(beyond, -0.4, -0.25), YELLOW, lit)
        _lay(colour, _band(beyond, 0.0, 0.9) * stripes[:, None], RED, lit)
        _lay(colour, _band(beyond, 0.0, 0.9) * ~stripes[:, None], CONCRETE, lit)
        _lay(colour, _band(beyond, 0.9, 1.9), CONCRETE, lit)
    elif edge.kind == "dirt":
        _lay(colour, _band(beyond, 0.0, 1.3), PACKED_EARTH, lit)
    elif edge.kind == "line":
        _lay(colour, _band(beyond, -0.4, -0.2), WHITE, lit)
    elif edge.kind == "wall":
        _lay(colour, _band(beyond, 0.0, PARAPET_M[1] + 0.5), PARAPET, lit)


def _blurred(base: NDArray[np.uint8], level: int) -> NDArray[np.uint8]:
    """The texture, averaged over 2**level texels across the road and half as many along it, which are longer."""
    size = (2**level + 1, max(1, 2 ** (level - 1)) * 2 - 1)
    return np.asarray(cv2.blur(cv2.copyMakeBorder(base, 4, 4, 0, 0, cv2.BORDER_WRAP), size), dtype=np.uint8)[4:-4]
