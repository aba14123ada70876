"""The simulator's three cameras: a height-field ray caster on numpy and OpenCV.

For each pixel, the ray caster computes the distance to the ground; the world's maps have the colour of this place.
Near the road the colour is from the unrolled road texture, elsewhere from the land's. Then grain or cobbles, haze,
the props next to the road, and the bonnet are drawn over it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import Camera
from simulator.pose import Pose
from simulator.rendering.noise import Field, cobble_tile, grain_tile
from simulator.rendering.props import PropsView
from simulator.rendering.raycast import COLUMNS, ROWS, Eye, RayCaster, look_up, on_map, with_rim
from simulator.rendering.terrain import CELL_M
from simulator.rendering.textures import ACROSS_M, REACH_M
from simulator.rendering.textures import COLUMNS as ROAD_COLUMNS
from simulator.rendering.world_maps import HAZE, SKY_BOTTOM, SKY_TOP, WorldMaps

BONNET_PX = 132  # the first row with the bonnet
PAINT, SHADE, GLOSS = (126, 138, 136), (60, 66, 66), (184, 194, 194)  # BGR


def draw_bonnet(camera: str, width_px: int, height_px: int) -> NDArray[np.uint8]:
    """The lowest rows, from ``BONNET_PX`` on: (height - BONNET_PX, width, 4) uint8 BGRA, transparent outside the
    bonnet."""
    fine = 4
    x = np.arange(width_px * fine) / fine
    if camera == "center":
        edge = 137.0 + 22.0 * (np.abs(x - 164.0) / 84.0) ** 2.6
    else:
        inner = x - 184.0 if camera == "left" else 122.0 - x  # distance from the bonnet's corner
        edge = np.where(inner > 0, 138.5 + 20.0 * np.exp(-np.maximum(inner, 0) / 9.0), 200.0)
    layer = np.zeros(((height_px - BONNET_PX) * fine, width_px * fine, 4), np.float32)
    y = (BONNET_PX + np.arange(layer.shape[0]) / fine)[:, None]
    depth = y - edge[None, :]
    shine = np.clip(1.0 - np.abs(depth - 3.0) / 3.0, 0.0, 1.0)[..., None]
    dull = np.clip((depth - 5.0) / 14.0, 0.0, 0.55)[..., None]
    colour = np.array(PAINT) + shine * (np.array(GLOSS) - PAINT)
    layer[..., :3] = colour + dull * (np.array(SHADE) - colour)
    layer[..., 3] = 255.0 * (depth > 0)
    rim = (depth > 0) & (depth < 0.8)
    layer[..., :3][rim] = SHADE
    small = cv2.resize(layer, (width_px, height_px - BONNET_PX), interpolation=cv2.INTER_AREA)
    return np.clip(small, 0, 255).astype(np.uint8)


Picture = NDArray[np.uint8]

WIDTH_PX, HEIGHT_PX = 320, 160
# Unity's default vertical field of view is 60 degrees: 80 px / tan(30 degrees).
FOCAL_PX = 138.6
# The horizon of the published lake recordings is at row 60 of 160, 20 px above the middle.
MOUNT_PITCH_RAD = -float(np.arctan(20.0 / FOCAL_PX))
MOUNT_FORWARD_M, MOUNT_UP_M = 1.5, 1.4
MOUNT_LEFT_M: dict[Camera, float] = {"center": 0.0, "left": 0.9, "right": -0.9}

HAZE_M = 420.0  # the distance at which 63 % of a colour is haze
GRAIN_TEXEL_M, COBBLE_TEXEL_M, COARSE_TEXEL_M = 0.02, 0.0125, 0.16
SKY_PER_M = 1e-4  # 1 / distance: pixels with this or less show the sky
SKY_SPARE_PX = 8  # additional rows of sky, for the other cameras at the same pose
SHARP_M = 9.0  # up to this distance, the sharpest level of the road texture is used
# The next levels begin at these multiples of SHARP_M: 1, 2 and 4, rounded like logarithms in single precision.
BLURRED_FROM = 1.0, 1.9999999, 3.9999995


@dataclass(frozen=True, eq=False)
class Directions:
    """The directions of a picture's pixels, relative to the horizontal: equal for all cameras at a pose."""

    rotation: NDArray[np.float64]  # from the car's axes (ahead, left, up) to horizontal axes
    side: Field  # (rows, columns): metres to the left, per metre ahead
    up: Field  # (rows, columns): metres up, per metre ahead
    side_range: tuple[float, float]
    up_range: tuple[float, float]
    table_column: Field  # (rows, columns): the pixel's column in the ray caster's result
    table_row: Field  # (rows, columns)


class Renderer:
    """Renders pictures of one world. A picture does not depend on earlier pictures."""

    def __init__(self, world: WorldMaps) -> None:
        self._world = world
        self._rays = RayCaster(world.height)
        length = np.float32(world.length_m)
        # Two maps of arc lengths, with seams half a lap apart: the map without a seam near the car is used.
        arcs = world.arc, np.where(world.arc > length / 2, world.arc - length, world.arc)
        self._arcs = tuple(map(with_rim, arcs))
        self._offset = with_rim(world.offset)
        # OpenCV processes four channels at once; the fourth, as in the road's texture, is for cobblestones.
        self._land = with_rim(np.dstack([world.ground, np.zeros(world.ground.shape[:2], np.uint8)]))
        self._panorama = cv2.cvtColor(world.sky, cv2.COLOR_BGR2BGRA)
        random = np.random.default_rng(3)
        self._grain, self._cobbles = grain_tile(random), cobble_tile(random)
        self._props = PropsView(world.props)
        self._kept_sky: tuple[Directions | None, float, Picture] = None, 0.0, np.zeros((0, 0, 4), np.uint8)
        self._bonnets = {camera: _bonnet(camera) for camera in MOUNT_LEFT_M}

    def render(self, pose: Pose, camera: Camera = "center", scale: float = 1.0) -> Picture:
        """The picture (160, 320, 3) uint8 BGR of a camera of a car at ``pose``. The same pose gives the same
        bytes. With ``scale``, it is ``scale`` times as wide and as high, with the same field of view."""
        width, height = round(WIDTH_PX * scale), round(HEIGHT_PX * scale)
        rays = _directions(pose.pitch_rad, pose.roll_rad, scale)
        eye = self._eye(pose, rays, MOUNT_LEFT_M[camera])
        table = self._rays.inverse_distance(eye, rays.side_range, rays.up_range)
        at, border = (rays.table_column, rays.table_row), cv2.BORDER_REPLICATE
        inverse = np.asarray(cv2.remap(table, *at, cv2.INTER_LINEAR, borderMode=border), dtype=np.float32)
        shown = np.zeros((height, width, 4), np.uint8)  # BGRA: OpenCV and numpy copy a pixel as one word
        first = int((inverse > SKY_PER_M).any(axis=1).argmax())  # all rows above show only sky
        shown[first:] = self._ground(eye, rays.side[first:], inverse[first:], scale)
        self._sky(shown, rays, inverse, pose.heading_rad)
        place = self._world.origin_m + CELL_M * np.array([eye.column, eye.row])
        self._props.draw(
            shown,
            inverse,
            (*place.tolist(), eye.height_m),
            pose.heading_rad,
            (rays.rotation @ _mount()).T,  # from horizontal axes (ahead, left, up) to the camera's axes
            FOCAL_PX * scale,
        )
        picture = np.asarray(cv2.cvtColor(shown, cv2.COLOR_BGRA2BGR), dtype=np.uint8)
        lowest = picture[round(BONNET_PX * scale) :]
        keep, paint = self._bonnets[camera] if scale == 1.0 else _bonnet(camera, (width, len(lowest)))
        np.floor_divide(lowest * keep + paint, 255, out=lowest, casting="unsafe")
        return picture

    def _eye(self, pose: Pose, rays: Directions, left_m: float) -> Eye:
        cos, sin = float(np.cos(pose.heading_rad)), float(np.sin(pose.heading_rad))
        ahead, left, up = rays.rotation @ (MOUNT_FORWARD_M, left_m, MOUNT_UP_M)
        x, y = pose.x_m + ahead * cos - left * sin, pose.y_m + ahead * sin + left * cos
        origin_x, origin_y = self._world.origin_m
        return Eye((x - origin_x) / CELL_M, (y - origin_y) / CELL_M, pose.z_m + up, cos, sin)

    def _ground(self, eye: Eye, side: Field, inverse: Field, scale: float) -> Picture:
        """The ground's colours (BGRA) at every pixel. ``_sky`` draws over the pixels of the sky."""
        world = self._world
        distance = 1.0 / np.clip(inverse, 1 / 400, np.inf)  # np.maximum would take twice as long
        reach = distance * np.float32(1 / CELL_M)
        column = np.float32(eye.column) + reach * (np.float32(eye.cos) - side * np.float32(eye.sin))
        row = np.float32(eye.row) + reach * (np.float32(eye.sin) + side * np.float32(eye.cos))
        x, y = on_map(self._offset, column, row)
        colours = np.asarray(cv2.remap(self._land, x, y, cv2.INTER_LINEAR))
        offset = np.asarray(cv2.remap(self._offset, x, y, cv2.INTER_LINEAR))
        on_road = np.abs(offset) < REACH_M - 0.2
        lap = float(world.length_m)
        beneath = (np.full((1, 1), at, np.float32) for at in (eye.column, eye.row))
        arc_of_car = float(look_up(self._arcs[0], *beneath)[0, 0])
        arcs = self._arcs[0 if 0.25 * lap < arc_of_car < 0.75 * lap else 1]
        near = slice(int(on_road.any(axis=1).argmax()), None)  # the rows above show no road
        blur = distance[near] * np.float32(1 / (SHARP_M * scale))
        level = np.sum([blur >= start for start in BLURRED_FROM], axis=0, dtype=np.uint8)
        texel = (offset[near] + np.float32(REACH_M)) * np.float32(1 / ACROSS_M) - np.float32(0.5)
        arc = np.asarray(cv2.remap(arcs, x[near], y[near], cv2.INTER_LINEAR), dtype=np.float32)
        texel = np.clip(texel, 0, ROAD_COLUMNS - 2) + level * np.float32(ROAD_COLUMNS)
        arc *= np.float32(world.road.shape[0] / lap)
        border = cv2.BORDER_WRAP
        road = np.asarray(cv2.remap(world.road, texel, arc, cv2.INTER_LINEAR, borderMode=border))
        # A pixel's four channels are copied as one word.
        np.copyto(colours.view(np.uint32)[near], road.view(np.uint32), where=on_road[near, :, None])
        *planes, cobbles = map(np.asarray, cv2.split(colours))
        gain = self._texture(eye, column, row, distance, np.asarray(cobbles, dtype=np.uint8))
        haze = np.exp(distance * np.float32(-1 / HAZE_M))
        gain *= haze
        mist = np.float32(1.0) - haze
        shown = [plane * gain + mist * np.float32(colour) for plane, colour in zip(planes, HAZE, strict=True)]
        return np.asarray(cv2.merge([*(cv2.convertScaleAbs(plane) for plane in shown), cobbles]), dtype=np.uint8)

    def _texture(self, eye: Eye, column: Field, row: Field, distance: Field, cobbles: Picture) -> Field:
        """The factors of the colours for grain, coarse unevenness and cobblestones. Each fades with the distance,
        when a pixel becomes larger than its details."""

        def tile(image: Picture, texel_m: float) -> Field:
            # Coordinates relative to a seam of the tiling near the eye: cv2.remap accepts at most 32767.
            scale, size = CELL_M / texel_m, len(image)
            seams = [np.float32(at * scale // size * size) for at in (eye.column, eye.row)]
            x, y = column * np.float32(scale), row * np.float32(scale)
            x -= seams[0]
            y -= seams[1]
            # cv2.remap could wrap, but at a sixth of its speed. Beyond the first seam, the coordinates are so
            # coarse that wrapping them here rounds nothing.
            if min(seams) >= size:
                _wrap(x, size)
                _wrap(y, size)
            values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
            return values.astype(np.float32) - np.float32(128.0)

        near, far = (np.clip(np.float32(reach_m) / distance, 0.0, 1.0) for reach_m in (5.0, 25.0))
        gain = tile(self._grain, GRAIN_TEXEL_M) * (near * near) + tile(self._grain, COARSE_TEXEL_M) * (
            far * far * np.float32(0.7)
        )
        if cobbles.any():
            stones = tile(self._cobbles, COBBLE_TEXEL_M) * np.clip(np.float32(12.0) / distance, 0.0, 1.0)
            share = cobbles * np.float32(1 / 255)
            gain += share * (np.float32(1.6) * stones - np.float32(0.7) * gain)
        return np.asarray(1.0 + gain * np.float32(1 / 256), dtype=np.float32)

    def _sky(self, picture: Picture, rays: Directions, inverse: Field, heading_rad: float) -> None:
        sky = inverse <= SKY_PER_M
        lowest = int(np.flatnonzero(sky.any(axis=1)).max(initial=-1)) + 1
        if lowest == 0:
            return
        # The sky is cached, because all cameras at a pose see the same sky.
        if self._kept_sky[:2] != (rays, heading_rad) or len(self._kept_sky[2]) < lowest:
            self._kept_sky = rays, heading_rad, self._sky_colours(rays, heading_rad, lowest + SKY_SPARE_PX)
        cv2.copyTo(self._kept_sky[2][:lowest], sky[:lowest].view(np.uint8), picture[:lowest])

    def _sky_colours(self, rays: Directions, heading_rad: float, height: int) -> Picture:
        """The upper rows of a picture that shows only sky, (``height``, W, 4) uint8 BGRA."""
        side, up = rays.side[:height], rays.up[:height]
        rows, columns = self._world.sky.shape[:2]
        azimuth = np.arctan(side) + np.float32(heading_rad)
        level = up / np.sqrt(1.0 + side * side)
        column = azimuth * np.float32(columns / (2 * np.pi))
        _wrap(column, columns)
        row = np.clip((SKY_TOP - level) * np.float32((rows - 1) / (SKY_TOP - SKY_BOTTOM)), 0, rows - 1)
        colours = cv2.remap(self._panorama, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        return np.asarray(colours, dtype=np.uint8)


def _bonnet(camera: Camera, size: tuple[int, int] | None = None) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """For a picture's lowest rows: the share of the picture that stays (0..255), and the bonnet's colours *
    alpha."""
    bonnet = draw_bonnet(camera, WIDTH_PX, HEIGHT_PX)
    if size is not None:
        bonnet = np.asarray(cv2.resize(bonnet, size), dtype=np.uint8)
    alpha = np.repeat(bonnet[..., 3:], 3, axis=2).astype(np.uint16)
    return 255 - alpha, bonnet[..., :3] * alpha + np.uint16(127)


def _wrap(values: Field, period: int) -> None:
    """Reduce the values modulo the period, in place: numpy's modulo takes ten times as long."""
    turns = values * np.float32(1 / period)
    np.floor(turns, out=turns)
    turns *= np.float32(period)
    values -= turns


@functools.lru_cache(maxsize=2)
def _directions(pitch_rad: float, roll_rad: float, scale: float) -> Directions:
    cp, sp, cr, sr = np.cos(pitch_rad), np.sin(pitch_rad), np.cos(roll_rad), np.sin(roll_rad)
    pitch = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    rotation = pitch @ roll  # without the heading
    # Each component of a pixel's ray is linear in the column and the row.
    rays = (rotation @ _mount()).astype(np.float32)
    right, down = (
        ((np.arange(size) + 0.5 - size / 2) / (FOCAL_PX * scale)).astype(np.float32)
        for size in (round(WIDTH_PX * scale), round(HEIGHT_PX * scale))
    )
    right, down = right[None, :], down[:, None]
    ahead_px, left_px, up_px = (rays[k, 0] - rays[k, 1] * right - rays[k, 2] * down for k in range(3))
    ahead_px = np.maximum(ahead_px, np.float32(0.05))
    side, up = left_px / ahead_px, up_px / ahead_px
    ranges = [(float(tangents.min()), float(tangents.max())) for tangents in (side, up)]
    at = [
        (tangents - np.float32(low)) * np.float32((size - 1) / (high - low))
        for tangents, size, (low, high) in zip((side, up), (COLUMNS, ROWS), ranges, strict=True)
    ]
    return Directions(rotation, side, up, ranges[0], ranges[1], at[0], at[1])


def _mount() -> NDArray[np.float64]:
    """The rotation from the camera's axes (ahead, left, up) to the car's."""
    cos, sin = np.cos(MOUNT_PITCH_RAD), np.sin(MOUNT_PITCH_RAD)
    return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
