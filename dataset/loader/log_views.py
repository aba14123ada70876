"""The pictures of a log as its car would have seen them from beside the line that it drove."""

from __future__ import annotations

from typing import Final

import numpy as np

from common import Skipped
from common.car import CAMERAS, Camera
from common.closeable import Closeable
from common.location import Location, location
from dataset.frames.frames_file import session_name
from dataset.frames.pairing import paired_rows
from dataset.loader.crops import UNDECODED
from dataset.picture_spec import ORIGINAL, PictureSpec
from dataset.preprocessing import Image, crop_of, decode
from dataset.recorded_line import DrivableStretch, stretches_to_drive
from dataset.viewpoint import Viewpoint
from recorder import Log, LogError
from recorder.errors import damaged_pictures
from recorder.log.session_car import Car, car_of
from recorder.log.tags import EXCLUDE, read_tags
from recorder.rows.row_quality import States
from recorder.topics import camera_topic

_CENTER: Final[Camera] = "center"


class LogViews(Closeable):
    """A log's rows, finished or not, numbered from 0, and what is seen at them. Use it as a context manager, or
    call `close()`."""

    def __init__(self, path: Location | str, car: str = "auto", picture: PictureSpec = ORIGINAL) -> None:
        """Raises LogError for a damaged log or tags, RecordingError if its car is unknown."""
        self.path = location(path)
        self.session = session_name(self.path)
        self.picture = picture
        self.skipped = Skipped()  # each picture once
        self._log = Log(self.path)
        try:
            self.geometry: Car = car_of(self._log, car)
            # as the wheels stood, also where an expert drove: of what he commanded they came later
            self.states = States.of(self._log.vehicle())
            self._tags = read_tags(self.path, self._log.fingerprint)
            self._places = {camera: self._places_of(camera) for camera in CAMERAS}
        except BaseException:
            self.close()
            raise
        self._viewpoints: dict[tuple[int, int], Viewpoint] = {}
        self._undecoded: set[tuple[int, Camera]] = set()

    def close(self) -> None:
        self._log.close()

    @property
    def notice(self) -> str:
        """A line about a log that was never finished; empty for a finished one."""
        return self._log.notice

    @property
    def stretches(self) -> list[DrivableStretch]:
        """The stretches of rows that can be driven, and are not tagged `exclude`."""
        row = self.states.row
        is_usable = np.zeros(len(row), np.bool_)
        is_usable[list(self._places[_CENTER])] = True
        for tag in self._tags:
            if tag.name == EXCLUDE:
                is_usable[(row >= tag.first_row) & (row <= tag.last_row)] = False
        return stretches_to_drive(self.states, is_usable)

    def crop_from(self, number: int, left_m: float, turn_rad: float) -> tuple[Image, float] | None:
        """The crop (`picture.shape`, in BGR) that the network sees of row `number` from a car that is `left_m`
        to the left of the line and turned to the left by `turn_rad`, and how much of it is known (0 .. 1); None
        without a whole picture of the centre camera."""
        centre = self._decoded(number, _CENTER)
        if centre is None:
            return None
        size = centre.shape[1], centre.shape[0]
        if size not in self._viewpoints:
            self._viewpoints[size] = Viewpoint(self.geometry, *size)
        viewpoint = self._viewpoints[size]
        pictures: dict[Camera, Image] = {_CENTER: centre}
        there = [camera for camera in CAMERAS if number in self._places[camera]]
        nearest = viewpoint.nearest(left_m, turn_rad, there)
        if nearest != _CENTER:
            beside = self._decoded(number, nearest)
            if beside is not None and beside.shape == centre.shape:
                pictures[nearest] = beside
        view = viewpoint.view(pictures, left_m, turn_rad)
        known = view.is_known[self.picture.crop_slice(size[1])]
        return crop_of(view.picture, self.picture), float(known.mean())

    def _places_of(self, camera: Camera) -> dict[int, tuple[int, int, int]]:
        """Offset, length and chunk of the picture of each row that has one."""
        found = self._log.pictures(camera_topic(camera))
        state, picture = paired_rows(found, self.states)
        places = (getattr(found, name)[picture].tolist() for name in ("offset", "length", "chunk"))
        return dict(zip(state.tolist(), zip(*places, strict=True), strict=True))

    def _decoded(self, number: int, camera: Camera) -> Image | None:
        if number not in self._places[camera]:
            return None
        try:
            return decode(self._log.read(*self._places[camera][number]))
        except LogError:
            kind = damaged_pictures(self.path)
        except ValueError:
            kind = UNDECODED
        if (number, camera) not in self._undecoded:
            self._undecoded.add((number, camera))
            self.skipped.add(kind, f"{self.session} row {self.states.row[number]} {camera}")
        return None
