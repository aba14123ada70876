"""Small recordings in the Udacity simulator's layout: real pictures, and a csv that the test writes in sight."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from common.car import CAMERAS, Camera


@cache
def jpeg(level: int, number: int = 0) -> bytes:
    """A 320x160 picture of one grey level with a number written on it."""
    picture = np.full((160, 320, 3), level, np.uint8)
    if number:
        cv2.putText(picture, str(number), (100, 100), cv2.FONT_HERSHEY_SIMPLEX, 2.0, (0, 200, 255), 3)
    return encode(picture)


def encode(picture: NDArray[Any], kind: str = ".jpg") -> bytes:
    ok, encoded = cv2.imencode(kind, picture)
    assert ok
    return encoded.tobytes()


def scene(camera: Camera, row: int) -> bytes:
    """A 320x160 picture of its own for every camera and row: coloured patches without symmetry."""
    random = np.random.default_rng((row, CAMERAS.index(camera)))
    return encode(cv2.resize(random.integers(0, 256, (6, 9, 3), dtype=np.uint8), (320, 160)))


def picture(camera: Camera, row: int) -> bytes:
    """A picture of its own for every frame."""
    return jpeg(60 + row, 10 * row + len(camera))


def picture_name(camera: Camera, number: int) -> str:
    """The name that the simulator gives to the picture taken `number` tenths of a second after the start."""
    return f"{camera}_2024_07_13_14_30_{16 + number // 10:02d}_{number % 10}00.jpg"


def paths(number: int, prefix: str = "IMG/", separator: str = ",") -> str:
    """The three paths of a row, as they begin a line of the csv."""
    return separator.join(prefix + picture_name(camera, number) for camera in CAMERAS)


def make_recording(
    folder: Path, csv: str | bytes, numbers: Iterable[int] = (0, 1, 2), img: str = "IMG"
) -> dict[str, bytes]:
    """Write the csv as it is and the pictures of some rows; the pictures' bytes by name."""
    (folder / img).mkdir(parents=True, exist_ok=True)
    (folder / "driving_log.csv").write_bytes(csv if isinstance(csv, bytes) else csv.encode())
    pictures = {
        picture_name(camera, number): jpeg((60 * position + 5 * number) % 256, 10 * number + position + 1)
        for number in numbers
        for position, camera in enumerate(CAMERAS)
    }
    for name, data in pictures.items():
        (folder / img / name).write_bytes(data)
    return pictures


def call(main: Callable[[], None], *arguments: object) -> int:
    """Run a command's `main` with this command line; its exit code."""
    before, switch_s = sys.argv, sys.getswitchinterval()
    sys.argv = ["command", *map(str, arguments)]
    try:
        with pytest.raises(SystemExit) as end:
            main()
    finally:
        sys.argv = before
        sys.setswitchinterval(switch_s)  # bc-drive sets it
    assert isinstance(end.value.code, int)
    return end.value.code
