"""Finds out by pictures whether a log's cameras are swapped, or one has the pictures of another.

Move a camera sideways by d, at the height h above a flat road. A road point R rows below the horizon then moves by
R * d / h columns to the other side, for any focal length. So the shift between two cameras' pictures, row by row,
gives d / h, without finding the road or the horizon.
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import Camera
from recorder.log.reader import Log
from recorder.pictures.picture_size import decode_picture, scaled_to_width
from recorder.topics import camera_topic

_CAMERAS: Final[tuple[Camera, ...]] = ("center", "left", "right")
_MAX_MOMENTS: Final = 60
_MIN_MOMENTS: Final = 20
_WIDTH_PX: Final = 320
_ROWS: Final = (0.4, 0.85)  # shares of the height: below most horizons, above most bonnets
_BANDS: Final = 18
_MAX_SHIFT: Final = 0.25  # share of the width
_NEAR_PX: Final = 1.5  # the largest distance of a band that fits the line
_MAX_ASKEW: Final = 0.15  # the largest difference of left and right, as a share of their mean

Edges = NDArray[np.float32]
Floats = NDArray[np.float64]


def swapped_cameras(log: Log) -> str:
    """The cameras whose pictures fit a level road only if swapped: "left and right", "center and left" or so, or
    "all three"; "" if there are none. Raises LogError for a damaged log."""
    places = [log.pictures(camera_topic(camera)) for camera in _CAMERAS]
    rows = _spread(set.intersection(*(set(pictures.sequence.tolist()) for pictures in places)))
    seen: dict[Camera, list[Edges]] = {camera: [] for camera in _CAMERAS}
    for row in rows:
        bands = [_bands(log.picture(row, camera)) for camera in _CAMERAS]
        whole = [edges for edges in bands if edges is not None]
        if len(whole) == 3 and len({edges.shape for edges in whole}) == 1:
            for camera, edges in zip(_CAMERAS, whole, strict=True):
                seen[camera].append(edges)
    if len(seen["center"]) < _MIN_MOMENTS:
        return ""

    @cache
    def share(on_left: Camera, on_right: Camera) -> float | None:
        both = zip(seen[on_left], seen[on_right], strict=True)
        likeness = np.mean([_likeness(first, second) for first, second in both], axis=0)
        return _slope(likeness, seen["center"][0].shape[1])

    def fit(center: Camera, left: Camera, right: Camera) -> bool:
        """True if the pictures show a level road, with left and right equally far from the centre."""
        shares = [found for found in (share(left, center), share(center, right)) if found is not None]
        return len(shares) == 2 and abs(shares[0] - shares[1]) <= _MAX_ASKEW * sum(shares) / 2

    order = next((order for order in itertools.permutations(_CAMERAS) if fit(*order)), _CAMERAS)
    moved = [camera for camera, other in zip(_CAMERAS, order, strict=True) if camera != other]
    return "all three" if len(moved) == 3 else " and ".join(moved)


def same_pictures(log: Log) -> list[str]:
    """The pairs of cameras with the same pictures, byte for byte: "center and left". Raises LogError for a damaged
    log."""
    pairs = []
    for first, second in itertools.combinations(_CAMERAS, 2):
        both = set(log.pictures(camera_topic(first)).sequence.tolist())
        rows = _spread(both.intersection(log.pictures(camera_topic(second)).sequence.tolist()))
        if len(rows) >= _MIN_MOMENTS and all(log.picture(row, first) == log.picture(row, second) for row in rows):
            pairs.append(f"{first} and {second}")
    return pairs


def _spread(rows: set[int]) -> list[int]:
    """At most `_MAX_MOMENTS` of the rows, evenly spread."""
    ordered, count = sorted(rows), min(len(rows), _MAX_MOMENTS)
    return [ordered[at] for at in np.linspace(0, len(rows) - 1, count).round().astype(int).tolist()]


def _bands(encoded: bytes) -> Edges | None:
    """Vertical edges in stripes of the ground (bands, rows, columns); None if the picture is damaged, too flat or
    too narrow."""
    picture = decode_picture(encoded, cv2.IMREAD_GRAYSCALE)
    small = None if picture is None else scaled_to_width(picture, _WIDTH_PX)
    if small is None:
        return None
    edges = cv2.Sobel(cv2.GaussianBlur(small, (3, 3), 0), cv2.CV_32F, 1, 0)
    first, last = (round(share * small.shape[0]) for share in _ROWS)
    band_rows = (last - first) // _BANDS
    if band_rows < 1:
        return None
    return np.asarray(edges[first : first + _BANDS * band_rows].reshape(_BANDS, band_rows, _WIDTH_PX), np.float32)


def _likeness(on_left: Edges, on_right: Edges) -> Floats:
    """The correlation (bands, shifts) of the columns x + shift of `on_left` with the columns x of `on_right`."""
    shifts = np.arange(round(_MAX_SHIFT * _WIDTH_PX) + 1)
    width = _WIDTH_PX - shifts  # columns in common
    a, b = on_left.astype(np.float64), on_right.astype(np.float64)
    both = [np.einsum("brc,brc->b", a[..., s:], b[..., :w]) for s, w in zip(shifts, width, strict=True)]
    count = a.shape[1] * width
    mean_a, mean_b, square_a, square_b = (
        np.cumsum(part.sum(axis=1), axis=1)[:, width - 1] / count
        for part in (a[..., ::-1], b, np.square(a[..., ::-1]), np.square(b))
    )
    size = np.sqrt(np.maximum((square_a - mean_a**2) * (square_b - mean_b**2), 0.0))
    return np.asarray((np.stack(both, axis=1) / count - mean_a * mean_b) / np.maximum(size, 1e-9))


def _slope(likeness: Floats, rows: int) -> float | None:
    """The shift in columns for each row, of bands with `rows` rows; None if the bands do not fit a line."""
    best = np.argmax(likeness[:, 1:-1], axis=1) + 1
    before, at, after = (likeness[np.arange(_BANDS), best + k] for k in (-1, 0, 1))
    bend = before - 2 * at + after
    shift = best + np.where(bend < 0, 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0).clip(-0.5, 0.5)
    row = rows * np.arange(_BANDS)
    # the median slope of all pairs (Theil-Sen) tolerates a bonnet in a third of the bands
    first, second = np.triu_indices(_BANDS, 1)
    slope = float(np.median((shift[second] - shift[first]) / (row[second] - row[first])))
    rest = shift - slope * row
    fits = np.abs(rest - np.median(rest)) < _NEAR_PX
    return slope if slope > 0 and fits.mean() >= 2 / 3 else None
