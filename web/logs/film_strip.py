"""Small pictures of a whole session: its film strip, in one JPEG, and a sketch of its steering."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import CAMERAS
from dataset.steering_bins import bin_of
from recorder import Log, LogError, Pictures
from recorder.pictures.picture_size import decode_picture
from recorder.rows.row_quality import Values
from recorder.topics import camera_topic

WIDTH, HEIGHT = 240, 40
_ALONG: Final = 170  # the curve's part of the width
_GAP: Final = 10
_LINE, _BARS, _AXIS = "#4a90d9", "#c77d1e", "#8884"  # readable on light and dark pages


def steering_sketch(steering: Values, bins: int) -> bytes:
    """A curve and a histogram of steering (N,) without its invalid values. Right is up in the curve, and right in
    the histogram."""
    values = steering[np.abs(steering) <= 1]
    heights = root_heights(np.bincount(bin_of(values, bins), minlength=bins), HEIGHT - 2)
    parts = [
        f'<path d="M0 {HEIGHT / 2}H{_ALONG}" stroke="{_AXIS}"/>',
        f'<path d="{_along(steering)}" stroke="{_LINE}" stroke-width="1" fill="none"/>',
        f'<path d="{bars(heights, _ALONG + _GAP, WIDTH, HEIGHT)}" fill="{_BARS}"/>',
    ]
    return svg(WIDTH, HEIGHT, parts)


def svg(width: int, height: int, parts: Iterable[str], attributes: str = "") -> bytes:
    start = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}"{attributes}>'
    return f"{start}{''.join(parts)}</svg>".encode()


def root_heights(counts: NDArray[np.int64], height: float) -> list[float]:
    """Heights by the square roots of counts, because most people steer straight ahead most of the time."""
    shares: list[float] = (height * np.sqrt(counts / max(1, counts.max()))).tolist()
    return shares


def bars(heights: Sequence[float], left: float, right: float, bottom: float, share: float = 0.8) -> str:
    """The path of bars between two edges. A bar fills a `share` of its place."""
    step = (right - left) / max(1, len(heights))
    inset, width = step * (1 - share) / 2, step * share
    return "".join(
        f"M{left + number * step + inset:.1f} {bottom}v{-height:.1f}h{width:.1f}v{height:.1f}z"
        for number, height in enumerate(heights)
        if height
    )


def _along(steering: Values) -> str:
    """At each point across, a stroke from the lowest to the highest steering."""
    edges = np.linspace(0, len(steering), min(_ALONG, max(len(steering), 1)) + 1).astype(int)
    step = _ALONG / (len(edges) - 1)
    half = HEIGHT / 2
    strokes = []
    for number, (first, last) in enumerate(pairwise(edges.tolist())):
        values = steering[first:last]
        values = values[np.abs(values) <= 1]
        if len(values):
            top, bottom = (half - float(value) * (half - 2) for value in (values.max(), values.min()))
            strokes.append(f"M{(number + 0.5) * step:.1f} {top - 0.5:.1f}V{bottom + 0.5:.1f}")
    return "".join(strokes)


PICTURES: Final = 4
WIDTH_PX, HEIGHT_PX = 160, 80  # of a picture; pages show it at half the size, for screens with two pixels a point
_QUALITY: Final = 80
_NO_PICTURE: Final = 128  # grey


def film_strip(log: Log) -> bytes:
    """`PICTURES` pictures of the first camera that has any, as one JPEG. A missing or damaged picture is a
    crossed-out box. Raises LogError if the log's index cannot be read."""
    strip = np.full((HEIGHT_PX, PICTURES * WIDTH_PX, 3), _NO_PICTURE, np.uint8)
    by_camera = (log.pictures(camera_topic(camera)) for camera in CAMERAS)
    pictures = next((pictures for pictures in by_camera if len(pictures.sequence)), None)
    for number in range(PICTURES):
        thumbnail = _thumbnail(log, pictures, (number + 0.5) / PICTURES)
        left = number * WIDTH_PX
        if thumbnail is None:
            corners = (left + 8, 8), (left + WIDTH_PX - 8, HEIGHT_PX - 8)
            cv2.line(strip, *corners, (80, 80, 80), 2)
            cv2.line(strip, (corners[0][0], corners[1][1]), (corners[1][0], corners[0][1]), (80, 80, 80), 2)
        else:
            strip[:, left : left + WIDTH_PX] = thumbnail
    ok, encoded = cv2.imencode(".jpg", strip, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not ok:
        raise LogError(f"{log.path}: its film strip cannot be encoded")
    return encoded.tobytes()


def _thumbnail(log: Log, pictures: Pictures | None, share: float) -> NDArray[np.uint8] | None:
    """The picture at a share of the session, in the strip's size; None if it is missing or damaged."""
    if pictures is None:
        return None
    at = int(share * len(pictures.sequence))
    try:
        data = log.read(int(pictures.offset[at]), int(pictures.length[at]), int(pictures.chunk[at]))
    except LogError:
        return None
    decoded = decode_picture(data, cv2.IMREAD_COLOR)
    if decoded is None:
        return None
    height, width = decoded.shape[:2]
    scale = max(WIDTH_PX / width, HEIGHT_PX / height)
    # cropped before it is resized: a picture of one row would become 80 times as wide
    kept_width, kept_height = (max(1, round(side / scale)) for side in (WIDTH_PX, HEIGHT_PX))
    left, top = (width - kept_width) // 2, (height - kept_height) // 2
    middle = decoded[top : top + kept_height, left : left + kept_width]
    return cv2.resize(middle, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA).astype(np.uint8)
