"""The centre camera's pictures of a log as the network sees them, with the recorded steering.

For viewing a whole log, which need not be in an index.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common import Skipped
from common.closeable import Closeable
from common.errors import printable
from common.files import session_name
from dataset.errors import DatasetError
from dataset.frames.frames_table import driven_states
from dataset.frames.pairing import paired_rows
from dataset.loader.crops import Crops, Failed, decoding_threads, prefetched
from dataset.picture_spec import ORIGINAL, PictureSpec
from dataset.preprocessing import Image
from dataset.samples.sample_rows import Rows
from recorder import Log, Pictures
from recorder.log.session_car import known_max_steering_deg, metadata_of, stored_car
from recorder.topics import camera_topic

_AT_ONCE: Final = 4  # batches in work


class LogCrops(Closeable):
    """The pictures of a finished or unfinished log, numbered from 0 in the order of writing; arrays (N,). Use it
    as a context manager, or call `close()`."""

    def __init__(self, path: Path | str) -> None:
        """Raises LogError if the log is damaged, DatasetError if it has no picture of the centre camera."""
        path = Path(path)
        self.session = printable(session_name(path))  # a file name may have invalid characters
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
        """The angle of the wheels at steering 1, in degrees; None: unknown."""
        return known_max_steering_deg(self.log)

    @property
    def about_car(self) -> dict[str, str]:
        """The entries about the car and the source in the log's metadata."""
        return {"log_source": self.log.metadata.get("source", ""), **metadata_of(stored_car(self.log))}

    def _read(self, pictures: Pictures) -> None:
        count = len(pictures.sequence)
        if not count:
            raise DatasetError(
                f"{self.log.path}: has no picture of the centre camera; `bc-log info` lists its topics"
            )
        self.row: NDArray[np.int64] = pictures.sequence
        self.log_time_ns: NDArray[np.int64] = pictures.log_time_ns
        states, _ = driven_states(self.log)
        state, picture = paired_rows(pictures, states)
        recorded = np.full(count, np.nan)
        recorded[picture] = states.steering[state]
        self.recorded = np.where(np.abs(recorded) <= 1, recorded, np.nan)
        """The steering (N,), -1..1, as in an index; NaN if the picture has no steering, or an invalid one."""
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
        """Yield the numbers of every `step`th picture and their crops, in order, in batches of at most `size`
        crops of `spec.shape`. Threads read ahead.

        Pictures that do not decode, or are in a damaged part of the log, are left out, and named in `skipped`.
        """
        numbers = np.arange(0, len(self), step)
        parts = np.split(numbers, numbers[size::size])
        threads = decoding_threads()
        crops = Crops(self._rows, {self.session: self.log}, budget_bytes=0, spec=spec)

        def skip(failed: Failed) -> None:
            for number, error in failed.items():
                if number not in self._undecoded:
                    self._undecoded.add(number)
                    self.skipped.add(error.kind, crops.name(number))

        return prefetched(parts, crops.fill, spec, skip, threads=threads, at_once=_AT_ONCE)
