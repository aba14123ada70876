"""The simulator's three cameras: a height-field ray caster on numpy and OpenCV.

For each pixel the ray caster finds how far away the ground is; that place is looked up in the world's maps.
Near the road the colour comes from the unrolled road texture, elsewhere from the land's; grain or cobbles
are laid over both, then haze, then what stands beside the road, and last the bonnet.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import Camera
from simulator.pose import Pose
from simulator.rendering.bonnet import TOP_PX as BONNET_PX
from simulator.rendering.bonnet import draw_bonnet
from simulator.rendering.noise import Field, cobble_tile, grain_tile
from simulator.rendering.props_view import PropsView
from simulator.rendering.raycast import COLUMNS, ROWS, Eye, RayCaster, look_up
from simulator.rendering.road_texture import ACROSS_M, LEVELS, REACH_M
from simulator.rendering.road_texture import COLUMNS as ROAD_COLUMNS
from simulator.rendering.sky import BOTTOM, HAZE, TOP
from simulator.rendering.terrain import CELL_M
from simulator.rendering.world_maps import WorldMaps

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
SKY_PER_M = 1e-4  # one over the distance: what is no nearer is sky
SHARP_M = 9.0  # up to here the road texture's sharpest level is right


@dataclass(frozen=True)
class View:
    """The directions of a picture's pixels: an eye, and per pixel the tangents to the left and up, level to
    the ground."""

    eye: Eye
    side: Field  # (rows, columns): metres to the left, per metre forward
    up: Field  # metres up, per metre forward


class Renderer:
    """Renders pictures of one world; holds no state between pictures."""

    def __init__(self, world: WorldMaps) -> None:
        self._world = world
        self._rays = RayCaster(world.height)
        length = np.float32(world.length_m)
        # A second map of arc lengths, with its seam half a lap away, so that no seam is ever near the car.
        self._arcs = (world.arc, np.where(world.arc > length / 2, world.arc - length, world.arc))
        random = np.random.default_rng(3)
        self._grain, self._cobbles = grain_tile(random), cobble_tile(random)
        self._props = PropsView(world.props)
        self._bonnets = {camera: draw_bonnet(camera, WIDTH_PX, HEIGHT_PX) for camera in MOUNT_LEFT_M}

    def render(self, pose: Pose, camera: Camera = "center", scale: float = 1.0) -> Picture:
        """The picture (160, 320, 3) uint8 BGR that a camera of a car at ``pose`` sees; the same pose, the
        same bytes. It is ``scale`` times as wide and as high, with the same field of view."""
        width, height = round(WIDTH_PX * scale), round(HEIGHT_PX * scale)
        rotation = _rotation(pose)
        view = self._view(pose, rotation, MOUNT_LEFT_M[camera], scale)
        inverse = self._inverse_distance(view)
        picture = np.zeros((height, width, 3), np.uint8)
        first = int((inverse > SKY_PER_M).any(axis=1).argmax())  # above it there is nothing but sky
        ground = View(view.eye, view.side[first:], view.up[first:])
        picture[first:] = self._ground(ground, inverse[first:], scale)
        self._sky(picture, view, inverse, pose.heading_rad)
        place = self._world.origin_m + CELL_M * np.array([view.eye.column, view.eye.row])
        self._props.draw(
            picture,
            inverse,
            (*place.tolist(), view.eye.height_m),
            pose.heading_rad,
            (rotation @ _mount()).T,  # from (ahead, left, up), level to the ground, to the camera's own axes
            FOCAL_PX * scale,
        )
        bonnet = self._bonnets[camera]
        lowest = picture[round(BONNET_PX * scale) :]
        if scale != 1.0:
            bonnet = np.asarray(cv2.resize(bonnet, (width, len(lowest))), dtype=np.uint8)
        alpha = bonnet[..., 3:].astype(np.uint16)
        lowest[...] = (lowest * (255 - alpha) + bonnet[..., :3] * alpha + 127) // 255
        return picture

    def _view(self, pose: Pose, rotation: NDArray[np.float64], left_m: float, scale: float) -> View:
        cos, sin = float(np.cos(pose.heading_rad)), float(np.sin(pose.heading_rad))
        ahead, left, up = rotation @ (MOUNT_FORWARD_M, left_m, MOUNT_UP_M)
        x, y = pose.x_m + ahead * cos - left * sin, pose.y_m + ahead * sin + left * cos
        origin_x, origin_y = self._world.origin_m
        eye = Eye((x - origin_x) / CELL_M, (y - origin_y) / CELL_M, pose.z_m + up, cos, sin)
        # Each component of a pixel's ray is linear in its column and row.
        rays = (rotation @ _mount()).astype(np.float32)
        right, down = (
            ((np.arange(size) + 0.5 - size / 2) / (FOCAL_PX * scale)).astype(np.float32)
            for size in (round(WIDTH_PX * scale), round(HEIGHT_PX * scale))
        )
        right, down = right[None, :], down[:, None]
        ahead_px, left_px, up_px = (rays[k, 0] - rays[k, 1] * right - rays[k, 2] * down for k in range(3))
        ahead_px = np.maximum(ahead_px, np.float32(0.05))
        return View(eye, left_px / ahead_px, up_px / ahead_px)

    def _inverse_distance(self, view: View) -> Field:
        side = (float(view.side.min()), float(view.side.max()))
        up = (float(view.up.min()), float(view.up.max()))
        table = self._rays.inverse_distance(view.eye, side, up)
        column = (view.side - np.float32(side[0])) * np.float32((COLUMNS - 1) / (side[1] - side[0]))
        row = (view.up - np.float32(up[0])) * np.float32((ROWS - 1) / (up[1] - up[0]))
        return look_up(table, column, row)

    def _ground(self, view: View, inverse: Field, scale: float) -> Picture:
        """The ground's colours at every pixel; those of the sky are left for ``_sky``."""
        world, eye = self._world, view.eye
        distance = 1.0 / np.maximum(inverse, np.float32(1 / 400))
        reach = distance * np.float32(1 / CELL_M)
        column = np.float32(eye.column) + reach * (np.float32(eye.cos) - view.side * np.float32(eye.sin))
        row = np.float32(eye.row) + reach * (np.float32(eye.sin) + view.side * np.float32(eye.cos))
        ground = cv2.remap(world.ground, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        offset = look_up(world.offset, column, row)
        here = look_up(world.arc, np.full((1, 1), eye.column, np.float32), np.full((1, 1), eye.row, np.float32))
        lap = float(world.length_m)
        arc = look_up(self._arcs[0 if 0.25 * lap < float(here[0, 0]) < 0.75 * lap else 1], column, row)
        rows = world.road.shape[0]
        level = np.clip(np.floor(np.log2(distance * np.float32(1 / (SHARP_M * scale))) + 1.0), 0, LEVELS - 1)
        texel = (offset + np.float32(REACH_M)) * np.float32(1 / ACROSS_M) - np.float32(0.5)
        on_road = np.abs(offset) < REACH_M - 0.2
        road = cv2.remap(
            world.road,
            texel + level * ROAD_COLUMNS,
            arc * np.float32(rows / lap),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_WRAP,
        )
        picture = np.where(on_road[..., None], road[..., :3], ground)
        gain = self._texture(eye, column, row, distance, np.where(on_road, road[..., 3], 0))
        haze = np.exp(distance * np.float32(-1 / HAZE_M))
        gain *= haze
        mist = np.float32(1.0) - haze
        planes = [picture[..., k] * gain + mist * np.float32(HAZE[k]) for k in range(3)]
        return np.asarray(cv2.convertScaleAbs(cv2.merge(planes)), dtype=np.uint8)

    def _texture(self, eye: Eye, column: Field, row: Field, distance: Field, cobbles: Picture) -> Field:
        """The factors of the colours by grain, coarse unevenness and cobblestones; each fades where pixels
        outgrow it."""

        def tile(image: Picture, texel_m: float) -> Field:
            # Counted from a seam of the tiling near the eye: cv2.remap takes no coordinates beyond 32767.
            scale, size = CELL_M / texel_m, len(image)
            seams = [np.float32(at * scale // size * size) for at in (eye.column, eye.row)]
            x, y = column * np.float32(scale) - seams[0], row * np.float32(scale) - seams[1]
            values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
            return values.astype(np.float32) - np.float32(128.0)

        near = np.minimum(np.float32(1.0), np.float32(5.0) / distance)
        far = np.minimum(np.float32(1.0), np.float32(25.0) / distance)
        gain = tile(self._grain, GRAIN_TEXEL_M) * (near * near) + tile(self._grain, COARSE_TEXEL_M) * (
            far * far * np.float32(0.7)
        )
        if cobbles.any():
            stones = tile(self._cobbles, COBBLE_TEXEL_M) * np.minimum(np.float32(1.0), np.float32(12.0) / distance)
            share = cobbles * np.float32(1 / 255)
            gain += share * (np.float32(1.6) * stones - np.float32(0.7) * gain)
        return np.asarray(1.0 + gain * np.float32(1 / 256), dtype=np.float32)

    def _sky(self, picture: Picture, view: View, inverse: Field, heading_rad: float) -> None:
        sky = inverse <= SKY_PER_M
        lowest = int(np.flatnonzero(sky.any(axis=1)).max(initial=-1)) + 1
        if lowest == 0:
            return
        side, up = view.side[:lowest], view.up[:lowest]
        rows, columns = self._world.sky.shape[:2]
        azimuth = np.arctan(side) + np.float32(heading_rad)
        level = up / np.sqrt(1.0 + side * side)
        column = azimuth * np.float32(columns / (2 * np.pi)) % columns
        row = np.clip((TOP - level) * np.float32((rows - 1) / (TOP - BOTTOM)), 0, rows - 1)
        colours = cv2.remap(self._world.sky, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        part = picture[:lowest]
        part[...] = np.where(sky[:lowest, :, None], colours, part)


def _rotation(pose: Pose) -> NDArray[np.float64]:
    """Takes (ahead, left, up) of the car to the same axes level to the ground, the heading kept."""
    cp, sp, cr, sr = np.cos(pose.pitch_rad), np.sin(pose.pitch_rad), np.cos(pose.roll_rad), np.sin(pose.roll_rad)
    pitch = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(pitch @ roll, dtype=np.float64)


def _mount() -> NDArray[np.float64]:
    """Takes the camera's (ahead, left, up) to the car's."""
    cos, sin = np.cos(MOUNT_PITCH_RAD), np.sin(MOUNT_PITCH_RAD)
    return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
