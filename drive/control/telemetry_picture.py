"""The camera's picture of a telemetry, decoded: a complete JPEG or PNG of a bounded size."""

from __future__ import annotations

from typing import Final

from dataset import decode
from dataset.preprocessing import Image
from recorder.pictures.picture_size import pixels
from recorder.server.telemetry import TelemetryError, check_whole_picture

MAX_PIXELS: Final = 1 << 21
"""The largest picture that is driven on. 1920x1080 is just within, and takes 10 ms to decode. The megabyte that a
telemetry may hold can unfold to 60 million pixels, and for the second that they take, the car would be left
alone."""


def camera_picture(encoded: bytes) -> tuple[Image, tuple[int, int]]:
    """The picture (height, width, 3) BGR, and the size in its header: by EXIF, decoding may turn it.

    Raises TelemetryError for one that is not complete, and for more than `MAX_PIXELS`.
    """
    try:
        size = check_whole_picture(encoded)
    except TelemetryError:
        _refuse_too_large(pixels(encoded))
        raise
    _refuse_too_large(size[0] * size[1])
    try:
        return decode(encoded), size
    except ValueError as error:
        raise TelemetryError("image does not decode", f" ({error})") from None


def _refuse_too_large(size: int) -> None:
    if size > MAX_PIXELS:
        raise TelemetryError(f"image has more than {MAX_PIXELS:,} pixels", f" ({size:,})")
