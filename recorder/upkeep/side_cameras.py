"""The distance of the side cameras from the centre one, measured in their own pictures.

A camera that is moved sideways by d, at the height h above a flat road, sees a point of the road that is R rows
below the horizon R * d / h columns farther to the other side, whatever its focal length. So the shift between two
cameras' pictures, row by row, gives d / h; neither the road nor the horizon has to be found in them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import MPS_PER_MPH, Camera
from recorder.errors import RecordingError
from recorder.log.reader import Log
from recorder.log.session_car import UDACITY, Car
from recorder.pictures.decoding import decode_picture, scaled_to_width
from recorder.rows.row_quality import STANDING_MPH
from recorder.topics import camera_topic
from simulator.driving.expert import LOOK_AHEAD_M, LOOK_AHEAD_S

UDACITY_SPACING: Final = 0.63
"""d / h of the real simulator, as measured here: 0.62 to 0.64 in published recordings of its three tracks."""
UDACITY_CORRECTION: Final = 0.2  # the label correction in use for it since the first projects with that simulator
UDACITY_MPH: Final = 10.0  # the speed at which their networks drove

_MEASURED: Final[tuple[Camera, ...]] = ("center", "left", "right")
MOMENTS: Final = 60
_MIN_MOMENTS: Final = 20  # to call the cameras swapped
_WIDTH_PX: Final = 320
_ROWS: Final = (0.4, 0.85)  # of the height: under most horizons, above most bonnets
_BANDS: Final = 18
_MAX_SHIFT: Final = 0.25  # of the width
_NEAR_PX: Final = 1.5  # a band that fits the line
_MAX_ASKEW: Final = 0.15  # how much left and right may differ, as a share of their mean

Gray = NDArray[np.uint8]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SideCameras:
    left: float  # distance from the centre camera, as a share of the cameras' height above the road
    right: float
    moments: int  # how many had all three pictures

    @property
    def spacing(self) -> float:
        return (self.left + self.right) / 2

    def side_correction(self, car: Car, speed_mph: float) -> float:
        """The label correction that leads this car back as Udacity's 0.2 does its own at 10 mph."""
        udacitys = _steering_back(UDACITY_SPACING * UDACITY.height_m, UDACITY, UDACITY_MPH)
        ours = _steering_back(self.spacing * car.height_m, car, speed_mph)
        return round(UDACITY_CORRECTION * ours / udacitys, 2)


def _steering_back(beside_m: float, car: Car, speed_mph: float) -> float:
    """The steering, as a share of full lock, with which the built-in simulator's expert leads a car back to a line
    from so far beside it (pure pursuit: curvature = 2 * distance / way^2, Coulter 1992, CMU-RI-TR-92-01)."""
    ahead_m = LOOK_AHEAD_M + LOOK_AHEAD_S * speed_mph * MPS_PER_MPH
    curvature = 2.0 * beside_m / (ahead_m**2 + beside_m**2)
    return math.atan(car.wheelbase_m * curvature) / car.max_wheel_rad


def usual_speed_mph(log: Log) -> float | None:
    """The median speed of the rows in which the car moves; None where no speed is known."""
    speed_mph = log.vehicle()["speed_mph"].to_numpy()
    moving = speed_mph[speed_mph > STANDING_MPH]  # False for NaN
    return float(np.median(moving)) if len(moving) else None


def side_cameras(log: Log, cameras: Sequence[Camera] = _MEASURED) -> SideCameras:
    """Measure in a log with pictures of all three cameras: the centre one, and those at its left and its right.
    Raises RecordingError where that is not possible."""
    places = [log.pictures(camera_topic(camera)) for camera in cameras]
    rows = np.array(sorted(set.intersection(*(set(pictures.sequence.tolist()) for pictures in places))), np.int64)
    if not len(rows):
        raise RecordingError(f"{log.path}: no moment has pictures of all three cameras")
    chosen = rows[np.unique(np.linspace(0, len(rows) - 1, MOMENTS).round().astype(int))].tolist()
    moments = (
        [decode_picture(log.picture(row, camera), cv2.IMREAD_GRAYSCALE) for camera in cameras] for row in chosen
    )
    try:
        return measure(moments)
    except ValueError as error:
        raise RecordingError(f"{log.path}: {error}") from None


def are_swapped(log: Log) -> bool:
    """True if the left camera's pictures are from the right of the centre one's, and the right one's from its
    left: they can be measured so, and not as they are called."""
    places = [log.pictures(camera_topic(camera)) for camera in _MEASURED]
    if not all(len(pictures.sequence) for pictures in places):
        return False
    try:
        side_cameras(log)
    except RecordingError:
        try:
            return side_cameras(log, ("center", "right", "left")).moments >= _MIN_MOMENTS
        except RecordingError:
            return False
    return False


def measure(moments: Iterable[list[Gray | None]]) -> SideCameras:
    """Measure in pictures (H, W) of the centre, left and right camera in many places; where one is None, of
    another size than the others, or too flat or narrow, the moment is passed over. Raises ValueError where it
    cannot be measured."""
    left: list[Floats] = []
    right: list[Floats] = []
    rows = 0  # of a band
    for pictures in moments:
        found_bands = (_bands(picture) for picture in pictures if picture is not None)
        bands = [band for band in found_bands if band is not None]
        if len(bands) == 3 and len({band.shape for band in bands}) == 1:
            centre, left_of, right_of = bands
            rows = centre.shape[1]
            left.append(_likeness(left_of, centre))
            right.append(_likeness(centre, right_of))
    if not left:
        raise ValueError("no moment has whole pictures of all three cameras, of one size and high enough")
    cameras = SideCameras(_slope(np.mean(left, axis=0), rows), _slope(np.mean(right, axis=0), rows), len(left))
    if abs(cameras.left - cameras.right) > _MAX_ASKEW * cameras.spacing:
        raise ValueError(
            f"the left camera is {cameras.left:.2f} of its height from the centre one, the right one"
            f" {cameras.right:.2f}: one correction does not fit both"
        )
    return cameras


def _bands(picture: Gray) -> NDArray[np.float32] | None:
    """(bands, rows, columns): edges that stand upright, in stripes of the ground; None of a picture that is too
    flat or too narrow to measure in."""
    small = scaled_to_width(picture, _WIDTH_PX)
    if small is None:
        return None
    edges = cv2.Sobel(cv2.GaussianBlur(small, (3, 3), 0), cv2.CV_32F, 1, 0)
    first, last = (round(share * small.shape[0]) for share in _ROWS)
    band_rows = (last - first) // _BANDS
    if band_rows < 1:
        return None
    return np.asarray(edges[first : first + _BANDS * band_rows].reshape(_BANDS, band_rows, _WIDTH_PX), np.float32)


def _likeness(to_the_right: NDArray[np.float32], other: NDArray[np.float32]) -> Floats:
    """(bands, shifts): the correlation of the first one's columns x + shift with the other's x."""
    shifts = np.arange(round(_MAX_SHIFT * _WIDTH_PX) + 1)
    width = _WIDTH_PX - shifts  # columns in common
    a, b = to_the_right.astype(np.float64), other.astype(np.float64)
    both = [np.einsum("brc,brc->b", a[..., s:], b[..., :w]) for s, w in zip(shifts, width, strict=True)]
    count = a.shape[1] * width
    mean_a, mean_b, square_a, square_b = (
        np.cumsum(part.sum(axis=1), axis=1)[:, width - 1] / count
        for part in (a[..., ::-1], b, np.square(a[..., ::-1]), np.square(b))
    )
    size = np.sqrt(np.maximum((square_a - mean_a**2) * (square_b - mean_b**2), 0.0))
    return np.asarray((np.stack(both, axis=1) / count - mean_a * mean_b) / np.maximum(size, 1e-9))


def _slope(likeness: Floats, rows: int) -> float:
    """Columns of shift for each row, of bands of so many rows each. Raises ValueError if they lie on no line."""
    best = np.argmax(likeness[:, 1:-1], axis=1) + 1
    before, at, after = (likeness[np.arange(_BANDS), best + k] for k in (-1, 0, 1))
    bend = before - 2 * at + after
    shift = best + np.where(bend < 0, 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0).clip(-0.5, 0.5)
    row = rows * np.arange(_BANDS)
    # the median of the slopes between all pairs (Theil and Sen): a bonnet in a third of the bands does no harm
    first, second = np.triu_indices(_BANDS, 1)
    slope = float(np.median((shift[second] - shift[first]) / (row[second] - row[first])))
    rest = shift - slope * row
    fits = np.abs(rest - np.median(rest)) < _NEAR_PX
    if slope <= 0 or fits.mean() < 2 / 3:
        raise ValueError(
            "the side cameras' pictures do not fit the centre one's on a level road: these cameras"
            " look in another direction, or show too little road"
        )
    return slope
