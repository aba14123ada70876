"""The crops of samples, and of a log that need not be in an index: read pictures from the logs, decode them ahead,
mirror and alter them, and cache the crops.

Any number of threads may use this at the same time; OpenCV releases Python's lock while it works.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from common import Skipped
from common.car import CAMERAS
from common.closeable import Closeable
from common.errors import printable
from common.files import session_name
from common.process_settings import usable_cores
from dataset.alterations import alter
from dataset.errors import DatasetError, UnusablePictureError
from dataset.frames.distinct_rows import number_distinct, paired_rows
from dataset.frames.frames_table import driven_states
from dataset.picture_spec import ORIGINAL, PictureSpec
from dataset.preprocessing import Image, crop_of, decode, in_channels
from dataset.samples.sample_rows import Rows
from recorder import Log, LogError, Pictures
from recorder.errors import damaged_pictures
from recorder.log.session_car import known_max_steering_deg, metadata_of, stored_car
from recorder.topics import camera_topic

UNDECODED: Final = "pictures that do not decode"
_JOBS: Final = 4  # jobs of a part for each thread: with small jobs, all threads finish at nearly the same time
_MOST_THREADS: Final = 8
"""Threads that decode pictures, if the user gives no number. A thread needs Python's lock several times for each
picture, and more threads mostly wait for it: on 16 cores, 7,644 pictures took 3.3 s with one thread, 1.0 s with
four, 0.8 s with eight, and 1.5 s with 16."""

Numbers = NDArray[np.int64]
Failed = dict[int, UnusablePictureError]
Fill = Callable[[Image, Numbers], Failed]
"""A function that writes the pictures with some numbers into an array, and returns the error of each number
without a picture."""


def decoding_threads() -> int:
    return min(usable_cores(), _MOST_THREADS)


def different_crops(rows: Rows) -> tuple[Numbers, Numbers]:
    """One sample for each distinct crop, sorted by picture; and for each sample (N,) the position of its crop.

    Every altered sample has its own crop; the other samples of a picture share a crop, mirrored or not.
    """
    # 0: the crop that all unaltered samples of a picture share
    own = np.where(_is_altered(rows), np.arange(1, len(rows) + 1), 0)
    crop, samples = number_distinct(own, rows.picture)
    return samples, crop.astype(np.int64)


def count_crops(rows: Rows) -> int:
    """The number of distinct crops (see `different_crops`), without sorting the samples."""
    is_altered = _is_altered(rows)
    return int(np.count_nonzero(is_altered)) + int(np.count_nonzero(np.bincount(rows.picture[~is_altered])))


def _is_altered(rows: Rows) -> NDArray[np.bool_]:
    return np.array([names != "" for names in rows.alterations], np.bool_)[rows.alteration]


class Crops:
    def __init__(
        self, rows: Rows, logs: Mapping[str, Log], budget_bytes: int, spec: PictureSpec = ORIGINAL
    ) -> None:
        """Cache as many crops as fit into `budget_bytes`: they are decoded once."""
        self._rows = rows
        self._spec = spec
        self._logs = [logs[session] for session in rows.sessions]
        kept = min(len(rows.session), budget_bytes // spec.size_bytes)
        self._kept = np.empty((kept, *spec.shape), np.uint8)  # the system provides memory only when it is written
        self._is_kept = np.zeros(kept, np.bool_)

    def fill(
        self, pictures: Image, samples: Numbers, altered: Callable[[Image, Numbers], object] | None = None
    ) -> Failed:
        """Write the pictures of `samples` (N,) into `pictures` (N, height, width, 3). `altered` alters BGR ones.

        Returns the error of each sample whose picture does not decode, or is in a damaged chunk of its log. The
        content of its picture is then arbitrary.
        """
        failed: Failed = {}
        columns = (self._rows.picture, self._rows.flip, self._rows.alteration, self._rows.seed)
        wanted = zip(pictures, samples.tolist(), *(column[samples].tolist() for column in columns), strict=True)
        cropped = -1
        for picture, sample, number, flip, alteration, seed in wanted:
            try:
                if number != cropped:  # neighbours in the index often share a picture
                    crop, cropped = self._crop(number), number
            except UnusablePictureError as error:
                failed[sample] = error
                continue
            if flip:
                cv2.flip(crop, 1, picture)  # a tenth of the time of crop[:, ::-1]
            else:
                picture[:] = crop
            if names := self._rows.alterations[alteration]:
                picture[:] = alter(picture, names, seed)
        if altered is not None:
            altered(pictures, samples)
        if self._spec.channels != "BGR":  # last, because alterations need BGR
            for picture in pictures:
                picture[:] = in_channels(picture, self._spec)
        return failed

    def name(self, number: int) -> str:
        """The name of a picture for messages: session, row and camera."""
        rows = self._rows
        log, offset, chunk = self._logs[rows.session[number]], int(rows.offset[number]), rows.chunk[number]
        with contextlib.suppress(LogError):  # a damaged log of an earlier version, which has no list of rows
            for camera in CAMERAS:
                pictures = log.pictures(camera_topic(camera))
                at = np.flatnonzero((pictures.offset == offset) & (pictures.chunk == chunk))
                if len(at):
                    return f"{rows.sessions[rows.session[number]]} row {pictures.sequence[at[0]]} {camera}"
        return f"{log.path} byte {offset}"  # the index is of another program

    def _crop(self, number: int) -> Image:
        if number >= len(self._kept):
            return self._decode(number)
        if not self._is_kept[number]:
            self._kept[number] = self._decode(number)
            self._is_kept[number] = True  # set last: another thread may read it at any moment
        kept: Image = self._kept[number]
        return kept

    def _decode(self, number: int) -> Image:
        rows = self._rows
        log = self._logs[rows.session[number]]
        offset = int(rows.offset[number])
        try:
            data = log.read(offset, int(rows.length[number]), int(rows.chunk[number]))
            return crop_of(decode(data), self._spec)
        except LogError as error:
            raise UnusablePictureError(damaged_pictures(log.path), str(error)) from None
        except ValueError as error:
            raise UnusablePictureError(UNDECODED, f"{log.path}: the picture at byte {offset}: {error}") from None


def prefetched(
    parts: Iterable[Numbers],
    fill: Fill,
    spec: PictureSpec,
    on_failed: Callable[[Failed], object],
    *,
    threads: int,
    at_once: int,
) -> Iterator[tuple[Numbers, Image]]:
    """Yield each part and its pictures (N, `spec.shape`) from `fill`, without the numbers that have no picture:
    `on_failed` gets their errors.

    Threads work on `at_once` parts at the same time. An error of `fill` is raised instead of its part.
    """

    def finished(part: Numbers, pictures: Image, jobs: list[Future[Failed]]) -> tuple[Numbers, Image]:
        failed = {number: error for job in jobs for number, error in job.result().items()}
        if not failed:
            return part, pictures
        on_failed(failed)
        is_decoded = ~np.isin(part, list(failed))
        return part[is_decoded], pictures[is_decoded]

    waiting: deque[tuple[Numbers, Image, list[Future[Failed]]]] = deque()
    pool = ThreadPoolExecutor(threads)
    try:
        for part in parts:
            pictures = np.empty((len(part), *spec.shape), np.uint8)
            size = max(1, -(-len(part) // (_JOBS * threads)))
            starts = range(0, len(part), size)
            jobs = [pool.submit(fill, pictures[i : i + size], part[i : i + size]) for i in starts]
            waiting.append((part, pictures, jobs))
            if len(waiting) == at_once:
                yield finished(*waiting.popleft())
        while waiting:
            yield finished(*waiting.popleft())
    finally:
        pool.shutdown(cancel_futures=True)


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
