"""Write a drive in the format of the training mode of Udacity's simulator: `driving_log.csv` and `IMG/`."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Self

from common import UserError, files
from common.car import Camera
from common.interrupts import uninterrupted
from common.untrusted import real_path

CSV_CAMERAS: tuple[Camera, ...] = ("center", "left", "right")


class UdacityWriter:
    """Writes a recording into `folder`, which must be empty or not exist. Use it as a context manager.

    At the end of the block, the csv gets its name; if the block raises, all files are removed. All methods raise
    UserError if the folder cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._images = real_path(folder) / "IMG"
        self._csv_path = folder / "driving_log.csv"
        self._part = files.part_path(self._csv_path)
        self._created: list[Path] = []
        with self._writing():
            if folder.exists() and any(folder.iterdir()):
                raise UserError(f"{folder}: not empty; a recording needs a new folder")
            self._created = files.make_folder(self._images)
            try:
                self._csv = self._part.open("x", encoding="utf-8", newline="")
            except OSError:
                files.remove_empty(self._created)
                raise

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
        """Write a row and its pictures. The pictures' names contain the time, in milliseconds."""
        moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=time_ns // 1000)
        stamp = f"{moment:%Y_%m_%d_%H_%M_%S}_{moment.microsecond // 1000:03d}"
        paths = [self._images / f"{camera}_{stamp}.jpg" for camera in CSV_CAMERAS]
        # C# prints floats with seven significant digits, and exponents as E-05
        speed_mph = abs(speed_mph)  # the simulator's speed has no sign
        values = [f"{value:.7g}".replace("e", "E") for value in (steering, throttle, brake, speed_mph)]
        with self._writing():
            for camera, path in zip(CSV_CAMERAS, paths, strict=True):
                path.write_bytes(jpegs[camera])
            self._csv.write(",".join([*map(str, paths), *values]) + "\n")

    def finish(self) -> None:
        """Flush all rows to the disk. The csv keeps its temporary name."""
        with self._writing():
            self._csv.flush()
            os.fsync(self._csv.fileno())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with uninterrupted():
            if kind is not None:
                self._discard()
                return
            with self._writing():
                self._csv.close()
            files.publish(self._part, self._csv_path, overwrite=False)

    def _discard(self) -> None:
        with contextlib.suppress(OSError):  # flushing the buffer fails again if the disk is full
            self._csv.close()
        self._part.unlink(missing_ok=True)
        shutil.rmtree(self._images, ignore_errors=True)
        files.remove_empty(self._created)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise UserError(
                f"{self._folder}: cannot be written ({error.strerror}); nothing was kept of it"
            ) from None
