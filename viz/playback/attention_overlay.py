"""A network's attention maps, drawn over its input pictures."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from dataset.preprocessing import Image
from viz.playback.picture_columns import picture_columns
from viz.timelines import Clock, Times

QUALITY: Final = 90  # of the JPEGs, some 7 KB each

_COLOR: Final = np.array((230, 40, 255), np.float32)  # BGR: no road has it
_MOST: Final = 0.8  # how much of it covers the picture where the network looks most
_DIMMED: Final = 0.8  # the picture's brightness


def overlay(crops: Image, maps: NDArray[np.float32]) -> Image:
    """Crops (N, 128, 128, 3) BGR and maps (N, 128, 128), 0..1, as pictures (N, 128, 128, 3): the crop, dimmed, and
    the more of a colour the higher the map."""
    share = _MOST * maps[..., None]
    blended = crops * (_DIMMED * (1 - share)) + _COLOR * share
    return blended.astype(np.uint8)


def send_overlays(
    recording: rr.RecordingStream,
    entity: str,
    clock: Clock,
    time_ns: Times,
    crops: Image,
    maps: NDArray[np.float32],
) -> None:
    """Send attention maps over their crops, as JPEGs at their log times."""
    settings = (cv2.IMWRITE_JPEG_QUALITY, QUALITY)
    jpegs = [cv2.imencode(".jpg", picture, settings)[1].tobytes() for picture in overlay(crops, maps)]
    recording.send_columns(entity, clock(time_ns), picture_columns(jpegs, ["jpeg"] * len(jpegs)))
