"""Batches for training, read directly from the logs.

    with load(Path("index"), batch=256) as loader:
        for batch in loader.epoch(1):
            batch.pictures, batch.steering

The order is a pure function of (seed, epoch), so that a resumed training gets the same samples. Threads decode
some batches ahead.

If a picture does not decode, or is in a damaged chunk of its log, it is left out: its batch is smaller, and
`Loader.skipped` names the picture.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, SupportsIndex

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common import Skipped
from common.closeable import Closeable
from common.location import local_path
from common.untrusted import real_path
from dataset.alterations import EpochAlterations
from dataset.config import EpochAlteration
from dataset.loader.crops import Crops, Failed, Fill, decoding_threads, prefetched
from dataset.picture_spec import ORIGINAL, PictureSpec
from dataset.prediction_targets import STEERING_ONLY, TargetName
from dataset.preprocessing import Image
from dataset.samples.sample_rows import Rows
from dataset.samples.samples_reader import Samples, Split, open_logs
from recorder.log.training_copies import bring_here


class SamplesDataset(Closeable):
    """The samples of a split for PyTorch's own DataLoader; `load` is faster, and needs no worker processes.

    Item i is (picture `seen.shape` uint8, steering -1..1 float32), mirrored and altered as in the index. With
    other targets, the second is (K,): see dataset.prediction_targets.

    Use it as a context manager, or call `close()`. It may be pickled and used after a fork: a worker process opens
    the logs again, and raises DatasetError if they have changed. An item whose picture does not decode raises
    DatasetError, because a data set cannot skip an item.
    """

    def __init__(
        self,
        index: Path | str,
        split: Split = "train",
        seen: PictureSpec = ORIGINAL,
        targets: Sequence[TargetName] = STEERING_ONLY,
    ) -> None:
        """Raises DatasetError if the index is missing, is damaged, or does not fit its logs."""
        self._index = real_path(local_path(index))  # a worker may have another working folder
        self._spec = seen
        samples = Samples(self._index)
        self._logs = samples.logs
        try:
            self._sources = samples.sources
            samples.refuse_missing(targets)
            self._rows = samples.rows_of_split(split, targets)
            self._crops = Crops(self._rows, self._logs, 0, self._spec)
        except BaseException:
            self.close()
            raise
        self._process = os.getpid()

    def close(self) -> None:
        for log in self._logs.values():
            log.close()

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, at: SupportsIndex) -> tuple[Image, np.float32 | NDArray[np.float32]]:
        if self._process != os.getpid():
            self._open()
        sample = at.__index__()
        picture = np.empty((1, *self._spec.shape), np.uint8)
        for error in self._crops.fill(picture, np.array([sample])).values():
            raise error
        return picture[0], self._rows.label[sample]

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: getattr(self, name) for name in ("_index", "_spec", "_sources", "_rows")}
        return {**kept, "_logs": {}, "_process": 0}

    def _open(self) -> None:
        self.close()  # the logs that the parent process had opened before the fork
        self._logs = open_logs(self._index, self._sources)
        self._crops = Crops(self._rows, self._logs, 0, self._spec)
        self._process = os.getpid()


DEFAULT_BUDGET_BYTES: Final = 1 << 30

_AHEAD: Final = 256  # pictures decoded ahead, 13 MB: more would not fit into the processor's caches


@dataclass(frozen=True)
class Batch:
    pictures: Image  # (N, height, width, 3), by default (N, 128, 128, 3) BGR
    labels: NDArray[np.float32]  # (N,) steering -1..1, or (N, K): see dataset.prediction_targets

    @property
    def steering(self) -> NDArray[np.float32]:
        """The steering labels (N,), -1..1."""
        return self.labels if self.labels.ndim == 1 else self.labels[:, 0]


class Loader(Closeable):
    """Batches of some rows of an index. Use it as a context manager, or call `close()`."""

    def __init__(
        self,
        samples: Samples,
        rows: pa.Table | Rows,
        *,
        batch: int,
        seed: int = 0,
        budget_bytes: int = DEFAULT_BUDGET_BYTES,
        threads: int = 0,
        seen: PictureSpec = ORIGINAL,
        targets: Sequence[TargetName] = STEERING_ONLY,
        alter_each_epoch: Sequence[EpochAlteration] = (),
    ) -> None:
        """`rows` are rows of `samples`, which `close()` closes. For the other arguments see `load`."""
        if batch < 1 or threads < 0 or seed < 0 or budget_bytes < 0:
            raise ValueError(
                f"batch must be at least 1, seed, threads and budget_bytes at least 0:"
                f" {batch=}, {seed=}, {threads=}, {budget_bytes=}"
            )
        self.batch = batch
        self.seed = seed
        self.threads = threads or decoding_threads()
        self.seen = seen
        self.rows: Rows = rows if isinstance(rows, Rows) else samples.rows(rows, targets)
        self.skipped = Skipped()  # each picture once
        self._samples = samples
        self._undecoded: set[int] = set()  # the pictures in `skipped`
        bring_here(samples.logs[session] for session in self.rows.sessions)
        self._crops = Crops(self.rows, samples.logs, budget_bytes, seen)
        self.alterations: EpochAlterations | None = None
        """The alterations that `epoch` applies to every picture. `in_order`, `crops` and `pictures_of` apply
        none."""
        if alter_each_epoch:
            self.alterations = EpochAlterations(alter_each_epoch, seed, samples.settings.side_correction)
        self._at_once = 1 + max(1, _AHEAD // batch)  # batches in work

    def close(self) -> None:
        self._samples.close()

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def batches(self) -> int:
        return -(-len(self) // self.batch)

    @property
    def pictures(self) -> int:
        """The number of distinct pictures of the samples."""
        return len(self.rows.session)

    def order(self, epoch: int) -> NDArray[np.int64]:
        """The order of the samples in an epoch, a permutation (N,)."""
        return self._order(epoch).astype(np.int64)

    def _order(self, epoch: int) -> NDArray[np.uint32]:
        """The same as `order`, with half of the memory."""
        return np.random.default_rng((self.seed, epoch)).permutation(np.arange(len(self), dtype=np.uint32))

    def parts(self, epoch: int, start_batch: int = 0) -> Iterator[NDArray[np.int64]]:
        """Yield the samples of each batch of an epoch, including those whose picture does not decode."""
        if not 0 <= start_batch <= self.batches:
            raise ValueError(f"start_batch must be in 0 to {self.batches}, not {start_batch}")
        return self._parts(self._order(epoch), start_batch)

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[Batch]:
        """Yield the batches of an epoch in shuffled order, from `start_batch` on. The last batch may be smaller,
        and so are batches with pictures that do not decode or are in a damaged chunk of their log."""
        return self._batches(self.parts(epoch, start_batch), epoch)

    def in_order(self) -> Iterator[Batch]:
        """Yield all samples once, in the order of the index (for evaluation)."""
        return self._batches(self._parts(np.arange(len(self), dtype=np.uint32), 0))

    def crops(self, samples: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], Image]]:
        """Yield samples and their crops (N, height, width, 3) in the order of `samples`, a batch at a time. The
        crops are not cached; if neighbours share a picture, it is decoded once."""
        size = max(1, min(self.batch, len(self)))
        parts = np.split(samples, np.arange(size, len(samples), size))
        return self._decoded(parts, Crops(self.rows, self._samples.logs, budget_bytes=0, spec=self.seen))

    @property
    def decoded(self) -> NDArray[np.bool_]:
        """A mask (N,) of the samples whose picture decodes or was not read yet."""
        return ~np.isin(self.rows.picture, list(self._undecoded))

    def pictures_of(self, samples: NDArray[np.int64]) -> Image:
        """The pictures (N, height, width, 3) of N samples, without those that do not decode. N is at most a
        batch."""
        ((_, pictures),) = self._decoded([samples], self._crops)
        return pictures

    def _parts(self, order: NDArray[np.uint32], start_batch: int) -> Iterator[NDArray[np.int64]]:
        for start in range(start_batch * self.batch, len(order), self.batch):
            yield order[start : start + self.batch].astype(np.int64)

    def labels(self, samples: NDArray[np.int64], epoch: int | None = None) -> NDArray[np.float32]:
        """The labels of samples; with `epoch`, the labels of their altered pictures in this epoch."""
        labels = self.rows.label[samples]
        if epoch is None or self.alterations is None:
            return labels
        return self.alterations.labels(labels, epoch, samples)

    def _batches(self, parts: Iterable[NDArray[np.int64]], epoch: int | None = None) -> Iterator[Batch]:
        decoded = self._decoded(parts, self._crops, epoch)
        return (Batch(pictures, self.labels(part, epoch)) for part, pictures in decoded)

    def _decoded(
        self, parts: Iterable[NDArray[np.int64]], crops: Crops, epoch: int | None = None
    ) -> Iterator[tuple[NDArray[np.int64], Image]]:
        """Yield the samples of each part whose pictures decode, and their pictures. The others are skipped."""
        fill: Fill = crops.fill
        if epoch is not None and self.alterations is not None:
            fill = partial(crops.fill, altered=partial(self.alterations.alter, epoch))
        return prefetched(parts, fill, self.seen, self._skip, threads=self.threads, at_once=self._at_once)

    def _skip(self, failed: Failed) -> None:
        for sample, error in failed.items():
            number = int(self.rows.picture[sample])
            if number not in self._undecoded:
                self._undecoded.add(number)
                self.skipped.add(error.kind, self._crops.name(number))


def load(
    index: Path | str,
    split: Split = "train",
    *,
    batch: int = 256,
    seed: int = 0,
    budget_bytes: int = DEFAULT_BUDGET_BYTES,
    threads: int = 0,
    driving_view: bool = False,
    seen: PictureSpec = ORIGINAL,
    targets: Sequence[TargetName] = STEERING_ONLY,
    alter_each_epoch: Sequence[EpochAlteration] = (),
) -> Loader:
    """Load the samples of a split of `index`, in batches of `batch`.

    - `budget_bytes`: memory for decoded crops (49 KB each)
    - `threads`: threads that decode; 0: one for each core, at most eight
    - `driving_view`: only the samples of `Samples.driving_view`
    - `seen`: the network's input
    - `targets`: the numbers that the network learns
    - `alter_each_epoch`: random alterations that `epoch` applies to every picture, different in every epoch

    Raises DatasetError if the index is missing, is damaged, or does not fit its logs.
    """
    samples = Samples(index)
    try:
        samples.refuse_missing(targets)
        rows = samples.driving_view(split) if driving_view else samples.rows_of_split(split, targets)
        return Loader(
            samples,
            rows,
            batch=batch,
            seed=seed,
            budget_bytes=budget_bytes,
            threads=threads,
            seen=seen,
            targets=targets,
            alter_each_epoch=alter_each_epoch,
        )
    except BaseException:
        samples.close()
        raise
