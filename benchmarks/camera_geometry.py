"""The geometry of a log's cameras and car, measured in its own pictures: what `recorder/log/session_car.py` says.

python benchmarks/camera_geometry.py sessions/*.mcap

- horizon and side cameras: with which the centre camera's pictures, warped to the side cameras' places, are most
  like theirs;
- focal length: a turn moves the far field by f (1 + (u / f)²) times its angle at u columns from the middle; the
  way ahead, that moves both sides outwards, does not hide it;
- wheelbase and lag: the turns of the far field over speed times the tangent of the wheels' angle. Nothing is
  infinitely far away, so that the turns come out some 6 % too large;
- height: with which the road's texture moves from row to row as the speed says, on straight stretches.
"""

from __future__ import annotations

import argparse
import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import CAMERAS, MPS_PER_MPH, Camera
from dataset.preprocess import Image, decode
from dataset.viewpoint import Viewpoint
from recorder import Log
from recorder.log.row_quality import States
from recorder.log.session_car import Car, car_of

FAR: Final = slice(28, 57)  # rows above the horizon
NEAR: Final = slice(78, 128), slice(50, 270)  # rows and columns of the road
ROAD: Final = slice(62, 130)  # without the bonnets
PATCH_PX: Final = 28
MOST_SHIFT_PX: Final = 75

Floats = NDArray[np.float64]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, nargs="+")
    print("| log | horizon, row | sides / height | focal length, rows | height, m | wheelbase, m | lag, s |")
    cv2.setNumThreads(1)
    for path in parser.parse_args().logs:
        with Log(path) as log:
            geometry, states = car_of(log), States.of(log.vehicle())
            horizon_px, spacing = side_cameras(log, geometry, states)
            focal_px, turns = far_field(log, states, geometry.focal * 160)
            wheelbase_m, lag_s = wheelbase(states, turns)
            found = f"{horizon_px:.1f} | {spacing:.3f} | {focal_px:.0f} | {height(log, geometry, states):.2f}"
        print(f"| {path.stem} | {found} | {wheelbase_m:.2f} | {lag_s:.2f} |", flush=True)


def side_cameras(log: Log, geometry: Car, states: States) -> tuple[float, float]:
    moving = states.row[states.speed_mph > 5]
    rows = moving[np.linspace(0, len(moving) - 1, 24).astype(int)].tolist()
    moments = [[decode(log.picture(row, camera)) for camera in CAMERAS] for row in rows]

    def error(horizon_px: float, spacing: float) -> float:
        beside_m = spacing * geometry.height_m
        there: dict[Camera, float] = {"center": 0.0, "left": beside_m, "right": -beside_m}
        changed = replace(geometry, horizon=horizon_px / 160, left_m=there)
        viewpoint, found = Viewpoint(changed, 320, 160), []
        for centre, *others in moments:
            for left_m, true in zip((beside_m, -beside_m), others, strict=True):
                view = viewpoint.view({"center": centre}, left_m, 0.0)
                gaps = np.abs(view.picture[ROAD].astype(np.int16) - true[ROAD])
                found.append(gaps[view.is_known[ROAD]].mean())
        return float(np.mean(found))

    tried = itertools.product(np.arange(57, 63.1, 0.5).tolist(), np.arange(0.60, 0.681, 0.01).tolist())
    return min(tried, key=lambda each: error(*each))


def far_field(log: Log, states: States, known_focal_px: float) -> tuple[float, Floats]:
    """The focal length in rows; and the turns to the left between neighbouring rows in rad, with the known one."""
    pictures = log.pictures("/camera/center")
    columns = (pictures.offset, pictures.length, pictures.chunk)
    places = zip(*(column[: len(states.row)].tolist() for column in columns), strict=True)
    grays = (gray(decode(log.read(*place))) for place in places)
    before, pairs = next(grays), []
    for after in grays:
        pairs.append(shifts(before, after))
        before = after
    errors = {}
    for focal_px in np.arange(110, 181, 5):
        fits = [turn_of(pair, float(focal_px)) for pair in pairs]
        errors[float(focal_px)] = np.mean([rest for turn, rest in fits if abs(turn) * focal_px > 4])
    turns = np.array([turn_of(pair, known_focal_px)[0] for pair in pairs])
    return min(errors, key=lambda focal_px: float(errors[focal_px])), turns


def shifts(first: Image, second: Image) -> Floats:
    """(N, 2): columns from the middle, and how far to the right what was there has moved."""
    found = []
    for left in range(20, 300 - PATCH_PX, 24):
        patch = first[FAR, left : left + PATCH_PX]
        begin = max(0, left - MOST_SHIFT_PX)
        window = second[FAR.start - 2 : FAR.stop + 2, begin : left + PATCH_PX + MOST_SHIFT_PX]
        if patch.std() < 8:
            continue
        likeness = cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED)
        row, column = np.unravel_index(int(likeness.argmax()), likeness.shape)
        if likeness[row, column] > 0.75 and 0 < column < likeness.shape[1] - 1:
            a, b, c = likeness[row, column - 1 : column + 2].tolist()
            between = (a - c) / (2 * (a - 2 * b + c) - 1e-9)  # the top of a parabola
            found.append((left + PATCH_PX / 2 - 160, int(column) + begin - left + between))
    return np.array(found).reshape(-1, 2)


def turn_of(pair: Floats, focal_px: float) -> tuple[float, float]:
    """The turn in rad that explains shifts best, and the mean rest in columns; NaN where there are too few."""
    if len(pair) < 6:
        return math.nan, math.nan
    middle, shift = pair.T
    terms = np.column_stack([focal_px * (1 + (middle / focal_px) ** 2), middle])
    weight = np.ones(len(shift))
    for _ in range(4):  # what does not fit counts less
        solved = np.linalg.lstsq(terms * weight[:, None], shift * weight, rcond=None)[0]
        rest = np.abs(shift - terms @ solved)
        weight = 1 / np.maximum(1.0, rest)
    return float(solved[0]), float(np.minimum(rest, 5).mean())


def wheelbase(states: States, turns: Floats) -> tuple[float, float]:
    time_s = (states.time_ns - states.time_ns[0]) / 1e9
    step_s, speed = np.diff(time_s), MPS_PER_MPH * states.speed_mph
    way_m = step_s * (speed[1:] + speed[:-1]) / 2
    good = np.isfinite(turns) & (step_s > 0) & (step_s < 0.3) & (speed[1:] > 2.2) & (np.abs(np.diff(speed)) < 1.3)
    best = (math.inf, math.nan, math.nan)
    for lag_s in np.arange(-0.1, 0.31, 0.05):
        steering = np.interp(time_s[:-1] + step_s / 2 - lag_s, time_s, states.steering)
        expected = (-way_m * np.tan(math.radians(25) * steering))[good]
        slope, weight = 1 / 3, np.ones(int(good.sum()))
        for _ in range(10):
            slope = np.sum(weight * expected * turns[good]) / np.sum(weight * expected**2)
            weight = 1 / np.maximum(0.003, np.abs(turns[good] - slope * expected))
        rest = float(np.minimum(np.abs(turns[good] - slope * expected), 0.05).mean())
        best = min(best, (rest, float(1 / slope), float(lag_s)))
    return best[1], best[2]


def height(log: Log, geometry: Car, states: States) -> float:
    """The median over pairs of rows: the car's rear axle moves ahead, and nothing turns."""
    time_s, straight = states.time_ns / 1e9, np.abs(states.steering) < 0.06
    step_s = np.diff(time_s)
    good = straight[1:] & straight[:-1] & (step_s > 0) & (step_s < 0.3) & (states.speed_mph[1:] > 3)
    chosen = np.flatnonzero(good & (np.abs(np.diff(states.speed_mph)) < 2))
    found = []
    for at in chosen[np.linspace(0, len(chosen) - 1, min(100, len(chosen))).astype(int)].tolist():
        first, second = (grain(decode(log.picture(int(states.row[at + k])))) for k in (0, 1))
        way_m = MPS_PER_MPH * float(states.speed_mph[at : at + 2].mean()) * float(step_s[at])
        likeness = {}
        for height_m in np.arange(1.0, 2.0, 0.03).tolist():
            moved = ahead(first, way_m, replace(geometry, height_m=height_m))
            likeness[height_m] = float(np.corrcoef(moved[NEAR].ravel(), second[NEAR].ravel())[0, 1])
        if max(likeness.values()) > 0.25:
            found.append(max(likeness, key=lambda height_m: likeness[height_m]))
    return float(np.median(found))


def ahead(picture: NDArray[np.float32], way_m: float, geometry: Car) -> NDArray[np.float32]:
    """The road as it is seen `way_m` farther on: where each pixel's line of sight meets it, seen from before."""
    focal_px = geometry.focal * 160
    down_rad = math.atan2(80 - geometry.horizon * 160, focal_px)
    cos, sin = math.cos(down_rad), math.sin(down_rad)
    right, below = np.meshgrid((np.arange(320) - 159.5) / focal_px, (np.arange(160) - 79.5) / focal_px)
    metres = geometry.height_m / np.maximum(sin + below * cos, 1e-3)
    on_m = metres * (cos - below * sin) + way_m
    axis_m = on_m * cos + geometry.height_m * sin
    columns = 159.5 + focal_px * metres * right / axis_m
    rows = 79.5 + focal_px * (geometry.height_m * cos - on_m * sin) / axis_m
    return np.asarray(cv2.remap(picture, columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR))


def grain(picture: Image) -> NDArray[np.float32]:
    values = gray(picture).astype(np.float32)
    return np.asarray(values - cv2.GaussianBlur(values, (0, 0), 3), np.float32)


def gray(picture: Image) -> Image:
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)


if __name__ == "__main__":
    main()
