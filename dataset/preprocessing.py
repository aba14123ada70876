"""Preprocess a camera's picture to the network's input. Training, driving and viewing use the same function."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common.errors import counted
from dataset.picture_spec import MAX_PX, ORIGINAL, PictureSpec
from recorder.pictures.picture_size import decode_picture, decoding_problem, pixels

Image = NDArray[np.uint8]

_FROM_BGR: Final = {"RGB": cv2.COLOR_BGR2RGB, "YUV": cv2.COLOR_BGR2YUV}
_TO_BGR: Final = {"RGB": cv2.COLOR_RGB2BGR, "YUV": cv2.COLOR_YUV2BGR}


def decode(encoded: bytes) -> Image:
    """Decode a JPEG or PNG to (height, width, 3) BGR uint8. Raises ValueError for other data, and if decoding
    would need too much memory or time."""
    picture = decode_picture(encoded, cv2.IMREAD_COLOR)
    if picture is None:
        why = decoding_problem(encoded) or f"{counted(len(encoded), 'byte')} that are not a picture"
        raise ValueError(why)
    return picture


def may_be_crop(encoded: bytes) -> bool:
    """True if the header is that of a JPEG or PNG with at most as many pixels as a network's input may have. The
    picture is not decoded."""
    return 0 < pixels(encoded) <= MAX_PX**2


def preprocess(picture: Image, spec: PictureSpec = ORIGINAL) -> Image:
    """Convert a camera picture, (height, width, 3) BGR uint8, to the network's input, `spec.shape` uint8."""
    return in_channels(crop_of(picture, spec), spec)


def crop_of(picture: Image, spec: PictureSpec = ORIGINAL) -> Image:
    """Crop and resize a camera picture (height, width, 3) to the network's input, still in BGR.

    The crop is a share of the height, so that pictures of another size show the same part of the world.
    """
    rows = picture[spec.crop_slice(picture.shape[0])]
    resized = cv2.resize(rows, (spec.width_px, spec.height_px), interpolation=cv2.INTER_LINEAR)
    return resized.astype(np.uint8, copy=False)


def in_channels(crop: Image, spec: PictureSpec) -> Image:
    """Convert a BGR crop to the network's order of colours; returns the same array if the order is BGR."""
    if spec.channels == "BGR":
        return crop
    return cv2.cvtColor(crop, _FROM_BGR[spec.channels]).astype(np.uint8, copy=False)


def as_bgr(crop: Image, spec: PictureSpec) -> Image:
    """Convert a network's input to BGR, to show it; returns the same array if it is already BGR."""
    if spec.channels == "BGR":
        return crop
    return cv2.cvtColor(crop, _TO_BGR[spec.channels]).astype(np.uint8, copy=False)
