"""A car that turns on the spot within a panorama: what its wheel did, its pictures show."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.writer import pose_message
from simulator.pose import Pose
from tests.helpers.logs import START_NS

RATE_HZ = 10.0
Seconds = NDArray[np.float64]


def hand(at_s: Seconds) -> Seconds:
    """The wheel at these times: turned all the time, never twice the same way."""
    return np.asarray(0.25 * np.sin(at_s * 1.3) + 0.2 * np.sin(at_s * 0.71 + 1) + 0.15 * np.sin(at_s * 2.9 + 2))


@cache
def views(rows: int) -> list[bytes]:
    """The JPEG at each row, (80, 160): the car turns by 60 columns a second at full lock."""
    noise = np.random.default_rng(0).uniform(-1, 1, (80, 900))
    far = np.clip(128 + 300 * cv2.GaussianBlur(noise, (0, 0), 1.5), 0, 255).astype(np.float32)
    step_s = 0.01
    heading = np.cumsum(hand(np.arange(0, rows / RATE_HZ, step_s))) * step_s * 60
    at = (np.arange(rows) / RATE_HZ / step_s).round().astype(int)
    shown = [cv2.getRectSubPix(far, (160, 80), (450 + float(heading[i]), 40.0)).astype(np.uint8) for i in at]
    return [cv2.imencode(".jpg", picture)[1].tobytes() for picture in shown]


def pressed(at_s: Seconds) -> Seconds:
    """The hand that the pictures show, where it turns enough: else the wheel is let go."""
    return np.where(np.abs(hand(at_s)) < 0.15, 0.0, hand(at_s))


def of_size(pictures: list[bytes], size: int) -> list[bytes]:
    """The same JPEGs with a comment, so that each has as many bytes as those of a car's camera."""
    comments = [size - len(picture) - 4 for picture in pictures]
    return [
        picture[:2] + b"\xff\xfe" + (count + 2).to_bytes(2) + bytes(count) + picture[2:]
        for picture, count in zip(pictures, comments, strict=True)
    ]


def write_drive(
    path: Path,
    pictures: list[bytes],
    wheel: Callable[[Seconds], Seconds] = hand,
    speed_mph: Callable[[Seconds], Seconds] | float = 15.0,
    *,
    heading_rad: Callable[[Seconds], Seconds] | None = None,
    live: bool = False,
    start_s: int = 0,
    device: VehicleState.Device = VehicleState.UNKNOWN,
    **about: str,
) -> Path:
    """A log of these pictures in which the wheel is noted to have stood so; `about` is its metadata."""
    at_s = np.arange(len(pictures)) / RATE_HZ
    steering = wheel(at_s)
    speed = speed_mph(at_s) if callable(speed_mph) else np.full(len(at_s), speed_mph)
    with LogWriter(path, {"source": "test"} | about, live=live) as writer:
        for row, picture in enumerate(pictures):
            time_ns = START_NS + start_s * 1_000_000_000 + round(row * 1e9 / RATE_HZ)
            state = VehicleState(
                steering=float(steering[row]), throttle=0.5, speed_mph=float(speed[row]), device=device
            )
            writer.picture("center", time_ns, row, picture)
            writer.vehicle(time_ns, row, state)
            if heading_rad is not None:
                pose = Pose(0.0, 0.0, 0.0, float(heading_rad(at_s)[row]))
                writer.pose(time_ns, row, pose_message(pose, time_ns))
    return path
