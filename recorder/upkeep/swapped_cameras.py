"""Whether the left and the right camera of a log are swapped, by their pictures.

A camera that is moved sideways by d, at the height h above a flat road, sees a point of the road that is R rows
below the horizon R * d / h columns farther to the other side, whatever its focal length. So the shift between two
cameras' pictures, row by row, gives d / h; neither the road nor the horizon has to be found in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import Camera
from recorder.log.reader import Log
from recorder.pictures.decoding import decode_picture, scaled_to_width
from recorder.topics import camera_topic

_CAMERAS: Final[tuple[Camera, ...]] = ("center", "left", "right")
_MAX_MOMENTS: Final = 60
_MIN_MOMENTS: Final = 20
_WIDTH_PX: Final = 320
_ROWS: Final = (0.4, 0.85)  # of the height: under most horizons, above most bonnets
_BANDS: Final = 18
_MAX_SHIFT: Final = 0.25  # of the width
_NEAR_PX: Final = 1.5  # a band that fits the line
_MAX_ASKEW: Final = 0.15  # how much left and right may differ, as a share of their mean

Gray = NDArray[np.uint8]
Edges = NDArray[np.float32]
Floats = NDArray[np.float64]


def are_swapped(log: Log) -> bool:
    """True if the left camera's pictures are from the right of the centre one's, and the right one's from its
    left: they fit a level road so, and not as they are called. Raises LogError for a damaged log."""
    places = [log.pictures(camera_topic(camera)) for camera in _CAMERAS]
    rows = sorted(set.intersection(*(set(pictures.sequence.tolist()) for pictures in places)))
    if not rows:
        return False
    chosen = np.unique(np.linspace(0, len(rows) - 1, _MAX_MOMENTS).round().astype(int)).tolist()
    centre: list[Edges] = []
    left: list[Edges] = []
    right: list[Edges] = []
    for row in (rows[at] for at in chosen):
        bands = [_bands(log.picture(row, camera)) for camera in _CAMERAS]
        whole = [edges for edges in bands if edges is not None]
        if len(whole) == 3 and len({edges.shape for edges in whole}) == 1:
            for camera_edges, edges in zip((centre, left, right), whole, strict=True):
                camera_edges.append(edges)
    return len(centre) >= _MIN_MOMENTS and not _fit(centre, left, right) and _fit(centre, right, left)


def _fit(centre: Sequence[Edges], left: Sequence[Edges], right: Sequence[Edges]) -> bool:
    """Whether these pictures are of a level road, and equally far to the left and right of the centre one's."""
    rows = centre[0].shape[1]  # of a band
    shares = [
        _slope(np.mean([_likeness(one, other) for one, other in pairs], axis=0), rows)
        for pairs in (zip(left, centre, strict=True), zip(centre, right, strict=True))
    ]
    measured = [share for share in shares if share is not None]
    return len(measured) == 2 and abs(measured[0] - measured[1]) <= _MAX_ASKEW * sum(measured) / 2


def _bands(encoded: bytes) -> Edges | None:
    """(bands, rows, columns): edges that stand upright, in stripes of the ground; None of a picture that is not
    whole, or too flat or too narrow to measure in."""
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


def _likeness(to_the_right: Edges, other: Edges) -> Floats:
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


def _slope(likeness: Floats, rows: int) -> float | None:
    """Columns of shift for each row, of bands of so many rows each; None if they lie on no line."""
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
    return slope if slope > 0 and fits.mean() >= 2 / 3 else None
