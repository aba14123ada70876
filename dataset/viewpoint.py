"""The view from beside the place of a recorded picture: warped to a car that is moved and turned.

Below the horizon every pixel is taken for a point of a level road, above it for one infinitely far away: the first
move as the plane of the road does, the second only turn with the car. What stands up from the road near by (curbs,
posts, trees, hills) is bent. Where nothing is known, the picture goes on as at the edge of what is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dataset.picture_spec import PictureSpec
from dataset.preprocessing import Image
from recorder.log.session_car import OUTLINE_PX, Car, Outline

Mask = NDArray[np.bool_]
Matrix = NDArray[np.float64]

MAX_TURN_RAD: Final = math.pi / 3
"""No camera here sees as far to the side; a view that is turned further has nothing in it."""


class Viewpoint:
    """Warps pictures of one size, taken by the centre camera of one car, or crops of them."""

    def __init__(
        self, geometry: Car, width_px: int, height_px: int, *, of_crops: PictureSpec | None = None
    ) -> None:
        """`of_crops`: what is warped are these crops of such pictures."""
        self.geometry = geometry
        # from a picture's pixels to those of what is warped; a pixel's middle is half a pixel beside its corner
        shown = np.eye(3)
        self.width_px, self.height_px = width_px, height_px
        if of_crops is not None:
            rows = of_crops.crop_slice(height_px)
            across, down = of_crops.width_px / width_px, of_crops.height_px / (rows.stop - rows.start)
            shown = np.array([[across, 0.0, 0.0], [0.0, down, -down * rows.start], [0.0, 0.0, 1.0]])
            self.width_px, self.height_px = of_crops.width_px, of_crops.height_px
        focal_px = geometry.focal * height_px
        intrinsic = np.array([[focal_px, 0.0, width_px / 2], [0.0, focal_px, height_px / 2], [0.0, 0.0, 1.0]])
        intrinsic = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]]) @ shown @ intrinsic
        down = math.atan2(0.5 - geometry.horizon, geometry.focal)
        cos, sin = math.cos(down), math.sin(down)
        # from the camera's (right, down, ahead) to the same axes level to the road
        level = np.array([[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]])
        self._to_level = level @ np.linalg.inv(intrinsic)
        self._from_level = intrinsic @ level.T
        horizon_px = float(shown[1, 1] * geometry.horizon * height_px + shown[1, 2])
        self._horizon_px = min(self.height_px, max(0, math.ceil(horizon_px - 0.5)))  # the first row of the road
        scale = height_px / OUTLINE_PX[1]  # about the middle: a wider picture shows more to either side
        beside_px = (width_px - scale * OUTLINE_PX[0]) / 2
        outline = shown @ np.array([[scale, 0.0, beside_px], [0.0, scale, 0.0], [0.0, 0.0, 1.0]])
        self._bonnet = _bonnet(geometry.bonnet.get("center", ()), outline, self.width_px, self.height_px)

    def picture(self, picture: Image, left_m: float, turn_rad: float) -> Image:
        """The picture (height, width, 3) BGR of the centre camera of a car whose rear axle is `left_m` to the left
        of where `picture` was taken (below 0: to the right), and which is turned to the left by `turn_rad` (below
        0: to the right). The car's bonnet stays where it is.

        Raises ValueError for a picture of another size, or a turn of more than `MAX_TURN_RAD`.
        """
        if not (abs(turn_rad) <= MAX_TURN_RAD and math.isfinite(left_m)):
            raise ValueError(f"no picture can be warped by {left_m} m and {turn_rad} rad")
        if picture.shape != (self.height_px, self.width_px, 3):
            raise ValueError(f"a picture of {picture.shape}, not {(self.height_px, self.width_px, 3)}")
        if left_m == turn_rad == 0.0:
            return picture
        bonnet = self._bonnet
        road = picture.copy()
        road[bonnet.first :] = picture[bonnet.above[bonnet.first :], np.arange(self.width_px)]
        warped = self._warp(road, left_m, turn_rad)
        below = slice(bonnet.first, None)
        np.copyto(warped[below], picture[below], where=bonnet.mask[below, :, None])
        return warped

    def _warp(self, picture: Image, left_m: float, turn_rad: float) -> Image:
        forward_m = self.geometry.forward_m
        aside_m = left_m + forward_m * math.sin(turn_rad) - self.geometry.left_m["center"]
        ahead_m = forward_m * (math.cos(turn_rad) - 1.0)
        warped = np.empty_like(picture)
        for first, end, matrix in (
            (0, self._horizon_px, self._far(turn_rad)),
            (self._horizon_px, self.height_px, self._road(ahead_m, aside_m, turn_rad)),
        ):
            if first < end:
                matrix = matrix @ np.array([[1.0, 0.0, 0.0], [0.0, 1.0, first], [0.0, 0.0, 1.0]])
                warped[first:end] = cv2.warpPerspective(
                    picture,
                    matrix,
                    (self.width_px, end - first),
                    flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                    borderMode=cv2.BORDER_REPLICATE,
                )
        return warped

    def _far(self, turn_rad: float) -> Matrix:
        """The map from pixels of the turned camera to those of the recorded one, for points at infinity."""
        return np.asarray(self._from_level @ _turn(turn_rad) @ self._to_level)

    def _road(self, ahead_m: float, aside_m: float, turn_rad: float) -> Matrix:
        """The same for points of the road: the homography of a plane (Hartley and Zisserman, section 13.1)."""
        move = np.zeros((3, 3))
        move[:, 1] = np.array([-aside_m, 0.0, ahead_m]) / self.geometry.height_m
        return np.asarray(self._from_level @ (_turn(turn_rad) + move) @ self._to_level)


def _turn(left_rad: float) -> Matrix:
    """The rotation from (right, down, ahead) of a car that is turned to the left to those of one that is not."""
    cos, sin = math.cos(left_rad), math.sin(left_rad)
    return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


@dataclass(frozen=True)
class _Bonnet:
    mask: Mask  # (height, width)
    first: int  # the first row with a part of it
    above: NDArray[np.intp]  # (height, width): the row to draw there so that the road goes on under the bonnet


def _bonnet(outline: Outline, shown: Matrix, width_px: int, height_px: int) -> _Bonnet:
    """`shown`: from the outline's pixels to those of the picture. Without corners there is none."""
    corners = np.array(outline or ((0.0, 1e6),), np.float64)
    columns, rows, _ = shown @ np.column_stack([corners, np.ones(len(corners))]).T
    column = np.arange(width_px) + 0.5
    top = np.floor(np.interp(column, columns, rows, left=np.inf, right=np.inf).clip(0, height_px)).astype(np.intp)
    row = np.arange(height_px)[:, None]
    return _Bonnet(row >= top, int(top.min()), np.minimum(row, np.maximum(top - 1, 0)))
