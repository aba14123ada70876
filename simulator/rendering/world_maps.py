"""A track's world as maps, from which the cameras' pictures are rendered."""

from __future__ import annotations

import contextlib
import hashlib
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common import UserError, atomic_file
from common.users_cache import users_cache
from simulator.rendering.noise import Field
from simulator.rendering.props import cast_shadows, place_props
from simulator.rendering.terrain import CELL_M, shape_terrain
from simulator.rendering.textures import paint_ground, paint_road
from simulator.roads.centreline import Floats
from simulator.roads.track import Track

_SKY_WIDTH_PX, _SKY_HEIGHT_PX = 2048, 256  # 360 degrees; the tangent of the elevation from SKY_TOP to SKY_BOTTOM
SKY_TOP, SKY_BOTTOM = 0.9, -0.1
HAZE = (200, 184, 166)  # BGR at the horizon
BLUE = (178, 122, 84)  # BGR overhead


def paint_sky(random: np.random.Generator, jungle: float) -> NDArray[np.uint8]:
    """The sky and the far hills at infinite distance: (256, 2048, 3) uint8 BGR. The columns are azimuths,
    counter-clockwise from east.

    ``jungle`` (0..1) makes the hills higher, nearer and darker.
    """
    tangent = np.linspace(SKY_TOP, SKY_BOTTOM, _SKY_HEIGHT_PX)[:, None, None]
    up = np.clip(tangent / 0.45, 0.0, 1.0) ** 0.7
    sky = np.array(HAZE) + up * (np.array(BLUE, dtype=np.float64) - HAZE) + np.zeros((1, _SKY_WIDTH_PX, 1))
    azimuth = np.linspace(0.0, 2 * np.pi, _SKY_WIDTH_PX, endpoint=False)
    bare, wooded = np.array([118.0, 140, 136]), np.array([46.0, 58, 50])
    for layer, (height, distance) in enumerate(((0.10, 0.55), (0.055, 0.25))):
        waves = range(3, 120, 4 - layer)
        ridge = sum(
            np.cos(k * azimuth + random.uniform(0, 6.28)) * random.uniform(0.2, 1.0) / k**0.8 for k in waves
        )
        top = height * (1.0 + 0.8 * jungle) * (0.55 + 0.28 * np.asarray(ridge))
        colour = bare + jungle * (wooded - bare)
        colour = colour + (np.array(HAZE) - colour) * distance * (1.0 - 0.5 * jungle)
        texture = 1.0 + 0.12 * random.normal(size=(_SKY_HEIGHT_PX, _SKY_WIDTH_PX, 1))
        cover = np.clip((top[None, :, None] - tangent) * _SKY_HEIGHT_PX / (SKY_TOP - SKY_BOTTOM) + 0.5, 0.0, 1.0)
        sky += cover * (colour * texture - sky)
    return np.asarray(cv2.blur(np.clip(sky, 0, 255).astype(np.uint8), (3, 1)), dtype=np.uint8)


FORMAT = 3  # of the cache files; increase it when the shape or the colours of a world change


@dataclass(frozen=True)
class WorldMaps:
    """Maps of square cells of ``CELL_M``, (rows to the north, columns to the east); cell [0, 0] is at
    ``origin_m``."""

    origin_m: Floats  # (2,) east, north
    length_m: Floats  # () of the road
    height: Field  # (rows, columns) metres
    offset: Field  # (rows, columns) metres from the centre line, positive to the left
    arc: Field  # (rows, columns) metres along the centre line
    ground: NDArray[np.uint8]  # (rows, columns, 3) BGR
    road: NDArray[np.uint8]  # see road_texture.paint_road
    sky: NDArray[np.uint8]  # see sky.paint_sky
    props: Floats  # see props.place_props

    def height_m(self, x_m: float, y_m: float) -> float:
        """The height of the ground, interpolated bilinearly between cells; beyond the map, that of its rim."""
        rows, columns = self.height.shape
        column = min(max((x_m - self.origin_m[0]) / CELL_M, 0.0), columns - 1.001)
        row = min(max((y_m - self.origin_m[1]) / CELL_M, 0.0), rows - 1.001)
        i, j = int(row), int(column)
        u, v = row - i, column - j
        cells = self.height[i : i + 2, j : j + 2].astype(np.float64)
        return float(
            (1 - u) * ((1 - v) * cells[0, 0] + v * cells[0, 1]) + u * ((1 - v) * cells[1, 0] + v * cells[1, 1])
        )


def build_world(track: Track, cache: bool = True) -> WorldMaps:
    """Build a track's world, or read it from the `users_cache` if an earlier call has built it.

    If the cache is damaged, old or read-only, the world is built again.
    """
    if not cache:
        return _build(track)
    name = track.name.replace(":", "-")
    path = users_cache() / f"world-{name}-{FORMAT}-{track.fingerprint()[:16]}.npz"
    world = _load(path)
    if world is None:
        world = _build(track)
        _save(path, world)
    return world


def _build(track: Track) -> WorldMaps:
    seed = int.from_bytes(hashlib.sha256(track.name.encode()).digest()[:8], "little")
    random = np.random.default_rng(seed)
    terrain = shape_terrain(track, random)
    props = place_props(track, terrain, random)
    light = cast_shadows(track, terrain, props, random)
    ground = paint_ground(track, terrain, light, random)
    return WorldMaps(
        origin_m=np.array(terrain.origin_m),
        length_m=np.array(track.line.length_m),
        height=terrain.height_m,
        offset=terrain.offset_m,
        arc=terrain.arc_m,
        ground=ground,
        road=paint_road(track, terrain, ground, light, random),
        sky=paint_sky(random, jungle=float(np.mean([track.looks[k].jungle for k in track.look_index]))),
        props=props,
    )


def _load(path: Path) -> WorldMaps | None:
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            return WorldMaps(**{field.name: file[field.name] for field in fields(WorldMaps)})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _save(path: Path, world: WorldMaps) -> None:
    arrays = {field.name: getattr(world, field.name) for field in fields(WorldMaps)}
    with (
        contextlib.suppress(OSError, UserError),
        atomic_file(path, overwrite=True) as part,
        part.open("wb") as file,
    ):
        np.savez(file, **arrays)
