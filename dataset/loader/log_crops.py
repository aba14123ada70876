"""The centre camera's pictures of a log as the network sees them, and the steering that was recorded with each.

For looking at a log, all of it, whether or not it is in an index.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common import Skipped
from common.closeable import Closeable
from common.errors import printable
from common.location import Location, location
from dataset.errors import DatasetError
from dataset.frames.frames_file import session_name
from dataset.frames.frames_table import driven_states
from dataset.frames.pairing import paired_rows
from dataset.loader.crops import Crops, prefetched
from dataset.picture_spec import ORIGINAL, PictureSpec
from dataset.preprocessing import Image
from dataset.samples.sample_rows import Rows
from recorder import Log, Pictures
from recorder.log.session_car import known_max_steering_deg, metadata_of, stored_car
from recorder.topics import camera_topic

_AT_ONCE: Final = 4  # batches that are worked on


class LogCrops(Closeable):
    """The pictures of a log, finished or not, numbered from 0 in the order of writing; arrays (N,). Use it as a
    context manager, or call `close()`."""

    def __init__(self, path: Location | str) -> None:
        """Raises LogError for a damaged log, DatasetError for one without a picture of the centre camera."""
        path = location(path)
        self.session = printable(session_name(path))  # a file name may be no text
        self.skipped = Skipped()  # each picture once
        self._undecoded: set[int] = set()
        self.log = Log(path)
        try:
            self._read(self.log.pictures(camera_topic("center")))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self.log.close()

    @property
    def max_steering_deg(self) -> float | None:
        """The wheels' angle at steering 1; None: unknown."""
        return known_max_steering_deg(self.log)

    @property
    def about_car(self) -> dict[str, str]:
        """The car's entry in the log's metadata, and the log's source."""
        return {"log_source": self.log.metadata.get("source", ""), **metadata_of(stored_car(self.log))}

    def _read(self, pictures: Pictures) -> None:
        count = len(pictures.sequence)
        if not count:
            raise DatasetError(
                f"{self.log.path}: no picture of the centre camera in it; `bc-log info` lists its topics"
            )
        self.row: NDArray[np.int64] = pictures.sequence
        self.log_time_ns: NDArray[np.int64] = pictures.log_time_ns
        self.recorded = self._recorded(pictures)
        """Steering, -1..1, as an index has it; NaN where the picture came without, or it cannot be."""
        self._rows = Rows(
            picture=np.arange(count, dtype=np.int32),
            flip=np.zeros(count, np.bool_),
            alteration=np.zeros(count, np.uint8),
            seed=np.zeros(count, np.int64),
            label=self.recorded.astype(np.float32),
            session=np.zeros(count, np.int32),
            offset=pictures.offset,
            length=pictures.length.astype(np.int32),
            chunk=pictures.chunk,
            alterations=("",),
            sessions=(self.session,),
        )

    def __len__(self) -> int:
        return len(self.row)

    def batches(
        self, size: int, spec: PictureSpec = ORIGINAL, step: int = 1
    ) -> Iterator[tuple[NDArray[np.int64], Image]]:
        """Numbers of pictures and their crops (at most `size` of `spec.shape`), in order, read ahead by threads;
        every `step`th picture.

        Pictures that do not decode, or lie where the log is damaged, are left out, and named in `skipped`.
        """
        numbers = np.arange(0, len(self), step)
        parts = np.split(numbers, numbers[size::size])
        threads = os.cpu_count() or 1
        of_log = Crops(self._rows, {self.session: self.log}, budget_bytes=0, spec=spec)
        for part, crops, failed in prefetched(parts, of_log.fill, spec, threads=threads, at_once=_AT_ONCE):
            for number, error in failed.items():
                if number not in self._undecoded:
                    self._undecoded.add(number)
                    self.skipped.add(error.kind, of_log.name(number))
            is_decoded = ~np.isin(part, list(failed))
            yield part[is_decoded], crops[is_decoded] if failed else crops

    def _recorded(self, pictures: Pictures) -> NDArray[np.float64]:
        states, _ = driven_states(self.log)
        state, picture = paired_rows(pictures, states)
        recorded = np.full(len(pictures.sequence), np.nan)
        recorded[picture] = states.steering[state]
        return np.where(np.abs(recorded) <= 1, recorded, np.nan)
