"""The pictures of a log's rows, as a dataset can have them: whole, and of one size for each camera."""

from __future__ import annotations

from common import Skipped
from common.car import Camera
from recorder.errors import LogError, damaged_pictures
from recorder.lerobot.log_episodes import LogEpisodes
from recorder.log.reader import Log
from recorder.pictures.decoding import is_whole_picture
from recorder.pictures.picture_size import SizeReader

Sizes = dict[Camera, tuple[int, int]]
"""Width and height of each camera's pictures."""


class RowPictures:
    """Reads the pictures of rows; those that cannot be used are skipped."""

    def __init__(self, log: Log, taken: LogEpisodes, sizes: Sizes, skipped: Skipped) -> None:
        """`sizes` are those of the dataset; the first pictures that are read set them."""
        self._log, self._rows, self._sizes, self._skipped = log, taken.states.row, sizes, skipped
        self._places = {
            camera: [
                column[taken.places[camera]].tolist() for column in (stored.offset, stored.length, stored.chunk)
            ]
            for camera, stored in taken.pictures.items()
        }
        self._size_readers = {camera: SizeReader() for camera in taken.pictures}

    def read(self, number: int) -> list[bytes] | None:
        """The cameras' pictures of one of the rows that are taken; None, and skipped, where one cannot be used."""
        pictures, sizes = [], Sizes()
        for camera, (offset, length, chunk) in self._places.items():
            try:
                picture = self._log.read(offset[number], length[number], chunk[number])
            except LogError:
                self.skip(damaged_pictures(self._log.path), number)
                return None
            size = self._size_readers[camera].width_and_height(picture)
            if size is None or not is_whole_picture(picture):
                self.skip("rows with a picture that is no whole JPEG or PNG", number)
                return None
            expected = self._sizes.get(camera, size)
            if size != expected:
                self.skip(f"rows whose {camera} picture is not {expected[0]} x {expected[1]} as the first", number)
                return None
            sizes[camera] = size
            pictures.append(picture)
        self._sizes |= sizes
        return pictures

    def skip(self, reason: str, number: int) -> None:
        self._skipped.add(reason, f"{self._log.path.name} row {self._rows[number]}")
