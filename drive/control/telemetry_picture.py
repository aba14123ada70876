"""Decode the camera's picture in a telemetry message: a complete JPEG or PNG of limited size."""

from __future__ import annotations

from typing import Final

from dataset import decode
from dataset.preprocessing import Image
from recorder.pictures.picture_size import pixels
from recorder.server.telemetry import TelemetryError, check_whole_picture

MAX_PIXELS: Final = 1 << 21
"""The largest accepted picture. 1920x1080 is just within, and takes 10 ms to decode. A message may hold a
megabyte, which can decode to 60 million pixels; during the second that this takes, nobody would control the
car."""


def camera_picture(encoded: bytes) -> tuple[Image, tuple[int, int]]:
    """The picture (height, width, 3) BGR, and the width and height in its header: decoding may rotate it by EXIF.

    Raises TelemetryError for an incomplete picture, and for more than `MAX_PIXELS`.
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
