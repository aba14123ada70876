"""A film strip of a session: pictures along it, side by side in one JPEG."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.car import CAMERAS
from recorder import Log, LogError, Pictures
from recorder.pictures.picture_size import decode_picture, width_and_height
from recorder.topics import camera_topic

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
    size = width_and_height(data) or (0, 0)
    is_large = min(size[0] // WIDTH_PX, size[1] // HEIGHT_PX) >= 2
    flag = cv2.IMREAD_REDUCED_COLOR_2 if is_large else cv2.IMREAD_COLOR  # JPEGs are decoded at half their size
    decoded = decode_picture(data, flag)
    if decoded is None:
        return None
    height, width = decoded.shape[:2]
    scale = max(WIDTH_PX / width, HEIGHT_PX / height)
    # cropped before it is resized: a picture of one row would become 80 times as wide
    kept_width, kept_height = (max(1, round(side / scale)) for side in (WIDTH_PX, HEIGHT_PX))
    left, top = (width - kept_width) // 2, (height - kept_height) // 2
    middle = decoded[top : top + kept_height, left : left + kept_width]
    return cv2.resize(middle, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA).astype(np.uint8)
