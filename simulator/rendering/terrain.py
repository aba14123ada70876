"""The land around a road, in square cells: the height of each cell, and its place relative to the road."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from simulator.rendering.noise import Field, smooth_noise
from simulator.roads.road_stretches import Edge
from simulator.roads.track import Track

CELL_M = 0.4
MARGIN_M = 90.0  # of land around the road's bounding box
VERGE_M = 1.3  # width of the ground next to the road that has the height of the road
PARAPET_M = (0.3, 1.5, 0.8)  # a bridge wall: from, to (beyond the road's edge), height
PARAPET_FACE_M = 0.5  # width of the wall's slanted faces: more than a cell, or the wall's foot would be ragged
WATER_BELOW_ROAD_M = 0.9  # below the lowest point of the road


@dataclass(frozen=True)
class Terrain:
    """Maps of the same shape (rows to the north, columns to the east). The centre of cell [0, 0] is
    ``origin_m``."""

    origin_m: tuple[float, float]
    height_m: Field
    offset_m: Field  # signed distance from the centre line, positive to the left
    arc_m: Field  # arc length of the nearest point of the centre line
    nearest: NDArray[np.int32]  # the number of the nearest point of the centre line
    beyond_m: Field  # distance from the road's edge, negative on the road
    water_level_m: float


def along_road(track: Track, values: NDArray[np.float64], smoothing_m: float) -> Field:
    """Convert a value for each look to a value for each point of the centre line, with soft transitions."""
    sharp = values[track.look_index]
    reach = max(1, round(smoothing_m / track.line.step_m))
    padded = np.concatenate([sharp[-reach:], sharp, sharp[:reach]])
    window = np.hanning(2 * reach + 3)[1:-1]
    return np.convolve(padded, window / window.sum(), mode="valid").astype(np.float32)


def smoothstep(values: Field) -> Field:
    """0 below 0, 1 above 1, with a smooth rise from 0 to 1."""
    t = np.clip(values, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def shape_terrain(track: Track, random: np.random.Generator) -> Terrain:
    plan = track.line.points_m[:, :2]
    low, high = plan.min(axis=0) - MARGIN_M, plan.max(axis=0) + MARGIN_M
    columns, rows = np.ceil((high - low) / CELL_M).astype(int)
    nearest, distance = _nearest_points(plan, low, (int(rows), int(columns)))
    offset, along = _project(track, nearest, low)
    arc = (nearest * np.float32(track.line.step_m) + along) % np.float32(track.line.length_m)
    beyond = np.abs(offset) - track.half_width_m.astype(np.float32)[nearest]
    # Far from the road, the distance to the circle of curvature is wrong: use the distance to the nearest point.
    beyond = np.where(distance > 20.0, distance - track.half_width_m.astype(np.float32)[nearest], beyond)

    points = track.line.points_m[:, 2].astype(np.float32)
    road = points[nearest] + track.line.slope.astype(np.float32)[nearest] * np.clip(along, -1.0, 1.0)
    small = cv2.resize(road, None, fx=1 / 8, fy=1 / 8, interpolation=cv2.INTER_AREA)
    smooth = cv2.resize(cv2.GaussianBlur(small, (0, 0), 8.0 / CELL_M / 4), road.shape[::-1])
    land = np.asarray(smooth, dtype=np.float32) + _hills(track, random, nearest, beyond)
    away = smoothstep((beyond - VERGE_M) / 16.0)
    height = road + away * (land - road) + _banks(track, random, nearest, offset, beyond)
    water = float(points.min()) - WATER_BELOW_ROAD_M
    return Terrain((float(low[0]), float(low[1])), np.maximum(height, water), offset, arc, nearest, beyond, water)


def _nearest_points(
    plan: NDArray[np.float64], low: NDArray[np.float64], shape: tuple[int, int]
) -> tuple[NDArray[np.int32], Field]:
    """For each cell the number of the nearest point of the centre line, and the distance to it in metres."""
    column, row = np.round((plan - low) / CELL_M).astype(int).T
    empty = np.full(shape, 255, np.uint8)
    empty[row, column] = 0
    distance, labels = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    point_of = np.zeros(int(labels.max()) + 1, np.int32)
    point_of[labels[row, column]] = np.arange(len(plan))
    return point_of[labels], np.asarray(distance * CELL_M, dtype=np.float32)


def _project(track: Track, nearest: NDArray[np.int32], low: NDArray[np.float64]) -> tuple[Field, Field]:
    """The signed distance of each cell from the centre line, and the arc length from the cell's nearest point.
    Both are exact if the road is an arc of a circle, so that the values are continuous between neighbouring
    points."""
    line = track.line
    x = (low[0] + CELL_M * np.arange(nearest.shape[1])).astype(np.float32)[None, :]
    y = (low[1] + CELL_M * np.arange(nearest.shape[0])).astype(np.float32)[:, None]
    dx = x - line.points_m[:, 0].astype(np.float32)[nearest]
    dy = y - line.points_m[:, 1].astype(np.float32)[nearest]
    cos, sin = (f(line.heading_rad).astype(np.float32)[nearest] for f in (np.cos, np.sin))
    along, across = dx * cos + dy * sin, dy * cos - dx * sin
    curvature = line.curvature_per_m.astype(np.float32)[nearest]
    # The distance to the centre of curvature, minus the radius, in a form that is also valid for a straight road.
    ahead, aside = curvature * along, 1.0 - curvature * across
    offset = (2 * across - curvature * (along**2 + across**2)) / (1.0 + np.hypot(ahead, aside))
    return offset, along / np.maximum(aside, 0.2)


def _hills(track: Track, random: np.random.Generator, nearest: NDArray[np.int32], beyond: Field) -> Field:
    """The height of hills, which grow with the distance from the road; in the jungle also of the trees' tops."""
    jungle = along_road(track, np.array([float(look.jungle) for look in track.looks]), 15.0)[nearest]
    rolling = 0.5 + 0.5 * smooth_noise(random, beyond.shape, 60.0 / CELL_M)
    rolling += 0.2 * smooth_noise(random, beyond.shape, 15.0 / CELL_M)
    far = smoothstep((beyond - 25.0) / 60.0)
    canopy = smooth_noise(random, beyond.shape, 2.2 / CELL_M) + smooth_noise(random, beyond.shape, 5.0 / CELL_M)
    woods = (2.5 + 1.6 * canopy) * smoothstep((beyond - 9.0) / 8.0)
    return rolling * (1.0 + (13.0 + 3.0 * jungle) * far) + jungle * woods


def _banks(
    track: Track, random: np.random.Generator, nearest: NDArray[np.int32], offset: Field, beyond: Field
) -> Field:
    """The height of cuttings, rock walls, shores, drops and parapets next to the road."""
    bank = per_side(track, nearest, offset, lambda edge: edge.bank_m)
    wall = per_side(track, nearest, offset, lambda edge: float(edge.kind == "wall"), 1.0)
    foot_m: Field = np.where(np.abs(bank) > 1.5, 2.6, 6.0).astype(np.float32)
    top_m: Field = np.where(bank < 0, 35.0, 12.0).astype(np.float32)
    rise = smoothstep(np.asarray((beyond - VERGE_M - 0.4) / foot_m, dtype=np.float32))
    end = 1.0 - smoothstep((beyond - top_m) / 30.0)
    rough = smooth_noise(random, beyond.shape, 3.0 / CELL_M) + smooth_noise(random, beyond.shape, 7.0 / CELL_M)
    banks = bank * rise * end * (1.0 + 0.22 * rough * (beyond > VERGE_M))
    # Away from the road, soften the cliffs across the land at the beginning and end of a stretch with a bank.
    small = cv2.GaussianBlur(cv2.resize(banks, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA), (0, 0), 3.0)
    soft = cv2.resize(small, banks.shape[::-1])
    banks += smoothstep((beyond - 5.0) / 8.0) * (soft - banks)
    start, stop, top = PARAPET_M
    parapet = smoothstep((beyond - start) / PARAPET_FACE_M) * (1.0 - smoothstep((beyond - stop) / PARAPET_FACE_M))
    return np.asarray(banks + top * wall * parapet, dtype=np.float32)


def per_side(
    track: Track,
    nearest: NDArray[np.int32],
    offset: Field,
    value: Callable[[Edge], float],
    smoothing_m: float = 5.0,
) -> Field:
    """For each cell, a value of the road's edge on its side, with soft transitions along the road."""
    left = along_road(track, np.array([value(look.left) for look in track.looks]), smoothing_m)
    right = along_road(track, np.array([value(look.right) for look in track.looks]), smoothing_m)
    return np.where(offset > 0, left[nearest], right[nearest])
