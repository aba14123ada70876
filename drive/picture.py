"""The camera's picture out of a telemetry: a whole JPEG that does not take too long."""

from __future__ import annotations

from typing import Final

from dataset import decode
from dataset.preprocess import Image
from recorder.jpeg import is_whole_jpeg
from recorder.picture_size import pixels

MOST_PIXELS: Final = 1 << 21
"""No larger picture is driven on. 1920x1080 is just within, and takes 10 ms to decode. The megabyte that a
telemetry may hold can say 60 million pixels, and for the second that they take, the car would be left alone."""


def camera_picture(jpeg: bytes) -> Image:
    """(height, width, 3) BGR. Raises ValueError for what is no whole JPEG, as the end of a cut one would be grey,
    and for more than `MOST_PIXELS`."""
    size = pixels(jpeg) or 0
    if size > MOST_PIXELS:
        raise ValueError(f"{size:,} pixels, of at most {MOST_PIXELS:,}")
    if not is_whole_jpeg(jpeg):
        raise ValueError(f"{len(jpeg):,} bytes that are not a picture: expected one whole JPEG")
    return decode(jpeg)
