"""The rows of a log that become frames of a dataset, their pictures and their episodes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from common import Skipped
from common.car import Camera
from common.stretches import within
from recorder.errors import LogError, damaged_pictures
from recorder.log.reader import Log
from recorder.log.tags import EXCLUDE, tags_of
from recorder.mcap.picture_places import Pictures
from recorder.pictures.picture_size import decode_picture, is_whole_picture, width_and_height
from recorder.rows.row_quality import States, drive_numbers
from recorder.topics import camera_topic

Sizes = dict[Camera, tuple[int, int]]  # width and height of each camera's pictures


@dataclass(frozen=True)
class ChosenRows:
    """The wanted rows of a log, with their sides of a split: `train` or `validation`."""

    row: NDArray[np.int64]  # (N,), ascending
    split: NDArray[np.str_]  # (N,)


@dataclass(frozen=True)
class LogEpisodes:
    """The used rows of a log, and their episodes."""

    states: States  # (N,)
    previous: NDArray[np.float64]  # (N, 3): steering, throttle and brake of the row before
    places: dict[Camera, NDArray[np.int64]]  # (N,) each: the position of the row's picture in `pictures`
    pictures: dict[Camera, Pictures]
    episodes: list[slice]
    excluded: int  # rows tagged `exclude`
    split: NDArray[np.str_] | None  # (N,); None if the whole log was wanted

    @property
    def steps_ns(self) -> NDArray[np.int64]:
        """The times from row to row in the episodes."""
        steps = [np.diff(self.states.time_ns[episode]) for episode in self.episodes]
        return np.concatenate([np.zeros(0, np.int64), *steps])

    def pictures_bytes(self, rows: range) -> int:
        """The size of all pictures of these rows (positions among the used rows)."""
        part = slice(rows.start, rows.stop)
        return sum(int(stored.length[self.places[camera][part]].sum()) for camera, stored in self.pictures.items())


def log_episodes(
    log: Log, cameras: Sequence[Camera], skipped: Skipped, chosen: ChosenRows | None = None
) -> LogEpisodes:
    """The rows of a log, or its `chosen` rows, with a picture of each of `cameras`, and steering and pedals in
    range.

    A new episode begins after more than a second without a used row, where time goes back, or where the side of
    the split changes. Rows tagged `exclude` are left out and counted; other unused rows are added to `skipped`.
    Raises LogError for a damaged log, or damaged tags.
    """
    states = States.of(log.vehicle())
    name = log.path.name
    excluded = [tag for tag in tags_of(log) if tag.name == EXCLUDE]
    is_excluded = within(states.row, [(tag.first_row, tag.last_row) for tag in excluded])
    taken = ~is_excluded
    if chosen is not None:
        taken &= np.isin(states.row, chosen.row)
    out_of_range = states.flags["out_of_range"]
    reason = f"rows of {name} with steering, pedals or speed out of range"
    _skip(skipped, reason, states.row[out_of_range & taken])
    taken &= ~out_of_range
    previous = _previous(states, ~out_of_range)
    pictures = {camera: log.pictures(camera_topic(camera)) for camera in cameras}
    places = {camera: _first_of_each(stored.sequence, states.row) for camera, stored in pictures.items()}
    for camera, place in places.items():
        is_missing = (place < 0) & taken
        _skip(skipped, f"rows of {name} without a picture of the {camera} camera", states.row[is_missing])
        taken &= ~is_missing
    kept = states.part(taken)
    split = None if chosen is None else chosen.split[np.searchsorted(chosen.row, kept.row)]
    begins = np.diff(drive_numbers(kept.time_ns), prepend=-1) != 0
    if split is not None:
        begins[1:] |= split[1:] != split[:-1]
    episodes = [slice(*ends) for ends in pairwise([*np.flatnonzero(begins).tolist(), len(kept.row)])]
    of_rows = {camera: place[taken] for camera, place in places.items()}
    return LogEpisodes(kept, previous[taken], of_rows, pictures, episodes, int(is_excluded.sum()), split)


def _previous(states: States, is_usable: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The steering, throttle and brake before each row (N, 3), from the last usable row of the same drive; 0
    without one."""
    vehicle = np.stack([states.steering, states.throttle, states.brake], axis=1)
    usable = np.flatnonzero(is_usable)
    if not len(usable):
        return np.zeros_like(vehicle)
    position = np.searchsorted(usable, np.arange(len(vehicle))) - 1
    before = usable[position]
    drive = drive_numbers(states.time_ns)
    is_same_drive = (position >= 0) & (drive[before] == drive)
    return np.where(is_same_drive[:, None], vehicle[before], 0.0)


def _first_of_each(sequence: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first position of each of `rows` in `sequence`; -1 if missing."""
    numbers, first = np.unique(sequence, return_index=True)
    if not len(numbers):
        return np.full(len(rows), -1, np.int64)
    at = np.searchsorted(numbers, rows).clip(max=len(numbers) - 1)
    return np.where(numbers[at] == rows, first[at], -1)


def _skip(skipped: Skipped, reason: str, rows: Iterable[np.int64]) -> None:
    for row in rows:
        skipped.add(reason, f"row {row}")


class RowPictures:
    """Reads the pictures of rows; rows with unusable pictures are skipped."""

    def __init__(self, log: Log, taken: LogEpisodes, sizes: Sizes, skipped: Skipped) -> None:
        """`sizes`: of the dataset; the first pictures set them."""
        self._log, self._rows, self._sizes, self._skipped = log, taken.states.row, sizes, skipped
        self._places = {
            camera: [
                column[taken.places[camera]].tolist() for column in (stored.offset, stored.length, stored.chunk)
            ]
            for camera, stored in taken.pictures.items()
        }

    def read(self, number: int) -> list[bytes] | None:
        """The cameras' pictures of a used row; None, and skipped, if one is unusable."""
        pictures, sizes = [], Sizes()
        for camera, (offset, length, chunk) in self._places.items():
            try:
                picture = self._log.read(offset[number], length[number], chunk[number])
            except LogError:
                self._skip(damaged_pictures(self._log.path), number)
                return None
            size = width_and_height(picture)
            if size is None or not is_whole_picture(picture):
                self._skip("rows with a picture that is not a whole JPEG or PNG", number)
                return None
            expected = self._sizes.get(camera, size)
            if size != expected:
                self._skip(
                    f"rows whose {camera} picture is not {expected[0]} x {expected[1]} as the first", number
                )
                return None
            sizes[camera] = size
            pictures.append(picture)
        self._sizes |= sizes
        return pictures

    def decode(self, number: int, encoded: Sequence[bytes]) -> list[NDArray[np.uint8]] | None:
        """The pictures of a row (height, width, 3) BGR; None, and skipped, if one does not decode."""
        decoded = [decode_picture(picture, cv2.IMREAD_COLOR) for picture in encoded]
        sound = [picture for picture in decoded if picture is not None]
        if len(sound) < len(decoded):
            self._skip("rows with a picture that does not decode", number)
            return None
        return sound

    def _skip(self, reason: str, number: int) -> None:
        self._skipped.add(reason, f"{self._log.path.name} row {self._rows[number]}")
