"""Writing a drive as the real simulator's training mode does: `driving_log.csv` and `IMG/`."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TextIO

from simulator.camera import Camera

ORDER: tuple[Camera, ...] = ("center", "left", "right")


class UdacityFolder:
    """A recording being written into `folder`, which must be empty or not exist (else FileExistsError)."""

    def __init__(self, folder: Path) -> None:
        self._images = folder.resolve() / "IMG"
        if folder.exists() and any(folder.iterdir()):
            raise FileExistsError(f"{folder}: not empty; a recording needs a new folder")
        self._images.mkdir(parents=True)
        self._csv: TextIO = (folder / "driving_log.csv").open("w", encoding="utf-8", newline="")

    def row(
        self,
        time_ns: int,
        jpegs: Mapping[Camera, bytes],
        *,
        steering: float,
        throttle: float,
        brake: float,
        speed_mph: float,
    ) -> None:
        """One row and its pictures; the time becomes part of their names, to the millisecond."""
        moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=time_ns // 1000)
        stamp = f"{moment:%Y_%m_%d_%H_%M_%S}_{moment.microsecond // 1000:03d}"
        paths = [self._images / f"{camera}_{stamp}.jpg" for camera in ORDER]
        for camera, path in zip(ORDER, paths, strict=True):
            path.write_bytes(jpegs[camera])
        # C# prints floats with seven significant digits, and exponents as E-05
        values = [f"{value:.7g}".replace("e", "E") for value in (steering, throttle, brake, speed_mph)]
        self._csv.write(",".join([*map(str, paths), *values]) + "\n")

    def close(self) -> None:
        self._csv.close()
