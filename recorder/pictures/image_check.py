"""Checks pictures: finds those that do not decode, and cameras that repeat the same picture."""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Callable, Collection
from concurrent.futures import Executor, Future
from typing import Final

import numpy as np

from common.stretches import stretches
from recorder.pictures.picture_size import decodes

FROZEN_PICTURES: Final = 3
"""This many equal pictures in a row from a moving car mean a frozen camera. A slow camera may repeat a picture
once."""

_PICTURES_A_JOB: Final = 32  # jobs of one picture would take a tenth longer
_JOB_BYTES: Final = 1 << 20
_MAX_WAITING_BYTES: Final = 1 << 24
_OVERHEAD_BYTES: Final = 256  # of a waiting picture, in addition to its own bytes

_Place = tuple[str, int]  # topic, and position among its pictures


class TopicPictures:
    """The checked pictures of one topic, in order, without their bytes: 17 bytes each."""

    def __init__(self) -> None:
        self.rows = array("q")
        self.times_ns = array("q")
        self._is_repeated = bytearray()
        self._last: bytes | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def add(self, row: int, time_ns: int, picture: bytes) -> None:
        self.rows.append(row)
        self.times_ns.append(time_ns)
        self._is_repeated.append(picture == self._last)
        self._last = picture

    @property
    def has_repeated(self) -> bool:
        return any(self._is_repeated)

    def frozen(self, standing: Collection[tuple[int, int]]) -> list[tuple[int, int]]:
        """The first and the last position of each stretch of equal pictures from a moving car.

        `standing`: row and time of the vehicle states in which the car stands, where equal pictures are right.
        """
        is_held = np.array(self._is_repeated, np.bool_)
        for at in np.flatnonzero(is_held).tolist():
            is_held[at] = (self.rows[at], self.times_ns[at]) not in standing
        # a stretch of repetitions begins with the picture that is repeated
        return [(first - 1, last) for first, last in stretches(is_held) if last - first + 2 >= FROZEN_PICTURES]


class ImageCheck:
    """Decodes the pictures of a log's topics, added in the log's order, and notes repeated ones."""

    def __init__(self, pool: Executor | None, on_decoded: Callable[[int], object] = lambda count: None) -> None:
        """`pool` decodes the pictures; None: no picture is decoded. `on_decoded` gets the number of newly decoded
        pictures."""
        self._pool = pool
        self._on_decoded = on_decoded
        self._job: list[tuple[_Place, bytes]] = []
        self._job_bytes = 0
        self._waiting: deque[tuple[list[_Place], int, Future[list[bool]]]] = deque()
        self._waiting_bytes = 0
        self.pictures: dict[str, TopicPictures] = {}  # by topic
        self.decoded = 0
        self.broken: list[_Place] = []
        """The pictures that do not decode, in the order of adding; complete after `finish`."""

    def add(self, topic: str, row: int, time_ns: int, picture: bytes) -> None:
        """Add a picture. Waits while too many bytes wait for decoding. `time_ns` must be below 2**63."""
        pictures = self.pictures.setdefault(topic, TopicPictures())
        pictures.add(row, time_ns, picture)
        if self._pool is None:
            return
        self._job.append(((topic, len(pictures) - 1), picture))
        self._job_bytes += len(picture) + _OVERHEAD_BYTES
        if len(self._job) == _PICTURES_A_JOB or self._job_bytes >= _JOB_BYTES:
            self._submit(self._pool)
            while self._waiting_bytes > _MAX_WAITING_BYTES:
                self._settle()

    def finish(self) -> None:
        if self._pool is not None:
            self._submit(self._pool)
        while self._waiting:
            self._settle()

    def _submit(self, pool: Executor) -> None:
        places = [place for place, _ in self._job]
        future = pool.submit(_decode_all, [picture for _, picture in self._job])
        self._waiting.append((places, self._job_bytes, future))
        self._waiting_bytes += self._job_bytes
        self._job, self._job_bytes = [], 0

    def _settle(self) -> None:
        places, size, future = self._waiting.popleft()
        self._waiting_bytes -= size
        self.broken.extend(place for place, is_sound in zip(places, future.result(), strict=True) if not is_sound)
        self.decoded += len(places)
        self._on_decoded(len(places))


def _decode_all(pictures: list[bytes]) -> list[bool]:
    return [decodes(picture) for picture in pictures]
