"""Batches for training, straight out of the logs.

    with load(Path("index"), batch=256) as loader:
        for batch in loader.epoch(1):
            batch.pictures, batch.steering

The order is a pure function of (seed, epoch), so a resumed training sees the samples it would have seen, and
several processes share an epoch without a word between them. Threads decode some batches ahead.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from dataset.buffers import Buffers
from dataset.crops import CROP_SHAPE, Crops
from dataset.preprocess import Image
from dataset.samples_file import LOADED, Samples, Split

DEFAULT_BUDGET_BYTES: Final = 1 << 30

_AHEAD: Final = 256  # pictures decoded before they are asked for, 13 MB: more fall out of the caches
_JOBS: Final = 4  # for each thread of a batch: small enough that none waits long for the others' last one


@dataclass(frozen=True)
class Batch:
    pictures: Image  # (N, 128, 128, 3) BGR
    steering: NDArray[np.float32]  # (N,), -1..1


class Loader:
    """Batches of some rows of an index. Use it as a context manager, or call `close()`."""

    def __init__(
        self,
        samples: Samples,
        rows: pa.Table,
        *,
        batch: int,
        seed: int = 0,
        rank: int = 0,
        ranks: int = 1,
        budget_bytes: int = DEFAULT_BUDGET_BYTES,
        threads: int = 0,
    ) -> None:
        """``rows`` are of ``samples``, which `close()` closes. For the rest see `load`."""
        if batch < 1 or threads < 0 or seed < 0 or budget_bytes < 0:
            raise ValueError(
                f"batch must be at least 1, seed, threads and budget_bytes at least 0:"
                f" {batch=}, {seed=}, {threads=}, {budget_bytes=}"
            )
        if not 0 <= rank < ranks:
            raise ValueError(f"rank must be one of the ranks, 0 to ranks - 1: {rank=}, {ranks=}")
        self.batch = batch
        self.seed = seed
        self.rank = rank
        self.ranks = ranks
        self.threads = threads or os.cpu_count() or 1
        self._samples = samples
        self._rows = samples.rows(rows)
        self._crops = Crops(self._rows, samples.logs, budget_bytes)
        self._at_once = 1 + max(1, _AHEAD * ranks // batch)  # batches that are worked on
        part = -(-min(batch, len(self)) // ranks)
        self._buffers = Buffers((part, *CROP_SHAPE), self._at_once + 1)

    def close(self) -> None:
        self._samples.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __len__(self) -> int:
        """Samples in an epoch, those of all ranks together."""
        return len(self._rows)

    @property
    def batches(self) -> int:
        """Batches in an epoch, for every rank the same number."""
        return -(-len(self) // self.batch)

    def order(self, epoch: int) -> NDArray[np.int64]:
        """Which sample comes when, in an epoch: every one once."""
        return np.random.default_rng((self.seed, epoch)).permutation(len(self))

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[Batch]:
        """The batches of an epoch in their shuffled order, from `start_batch` on; the last one may be smaller."""
        if not 0 <= start_batch <= self.batches:
            raise ValueError(f"start_batch must be in 0 to {self.batches}, not {start_batch}")
        return self._batches(self.order(epoch), start_batch)

    def in_order(self) -> Iterator[Batch]:
        """All samples once, in the order of the index (for evaluation)."""
        return self._batches(np.arange(len(self)), 0)

    def _batches(self, order: NDArray[np.int64], start_batch: int) -> Iterator[Batch]:
        starts = range(start_batch * self.batch, len(order), self.batch)
        waiting: deque[tuple[Batch, list[Future[None]]]] = deque()
        pool = ThreadPoolExecutor(self.threads)
        try:
            for start in starts:
                together = order[start : start + self.batch]
                waiting.append(self._begin(np.array_split(together, self.ranks)[self.rank], pool))
                if len(waiting) == self._at_once:
                    yield _finished(*waiting.popleft())
            while waiting:
                yield _finished(*waiting.popleft())
        finally:
            pool.shutdown(cancel_futures=True)

    def _begin(self, samples: NDArray[np.int64], pool: ThreadPoolExecutor) -> tuple[Batch, list[Future[None]]]:
        """A batch, and the jobs that fill in its pictures."""
        pictures = self._buffers.take()[: len(samples)]
        size = max(1, -(-len(samples) // (_JOBS * self.threads)))
        jobs = [
            pool.submit(self._crops.fill, pictures[i : i + size], samples[i : i + size])
            for i in range(0, len(samples), size)
        ]
        return Batch(pictures, self._rows.label[samples]), jobs


def load(
    index: Path | str,
    split: Split = "train",
    *,
    batch: int = 256,
    seed: int = 0,
    rank: int = 0,
    ranks: int = 1,
    budget_bytes: int = DEFAULT_BUDGET_BYTES,
    threads: int = 0,
    driving_view: bool = False,
) -> Loader:
    """The samples of a split of `index`, in batches of `batch` over all `ranks`, of which this process is `rank`:
    whatever their number, batch k is the same, and each takes its part of it (one may be empty in the last).

    `budget_bytes` is how much memory decoded crops may take (49 KB each); `threads` decode (0: one for each core);
    `driving_view` leaves only what the car sees itself (`Samples.driving_view`).
    Raises DatasetError if there is no index, if it is damaged or does not fit its logs.
    """
    samples = Samples(Path(index))
    try:
        rows = samples.driving_view(split) if driving_view else samples.of_split(split, LOADED)
        return Loader(
            samples,
            rows,
            batch=batch,
            seed=seed,
            rank=rank,
            ranks=ranks,
            budget_bytes=budget_bytes,
            threads=threads,
        )
    except BaseException:
        samples.close()
        raise


def _finished(batch: Batch, jobs: list[Future[None]]) -> Batch:
    for job in jobs:
        job.result()
    return batch
