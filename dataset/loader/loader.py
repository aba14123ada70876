"""Batches for training, straight out of the logs.

    with load(Path("index"), batch=256) as loader:
        for batch in loader.epoch(1):
            batch.pictures, batch.steering

The order is a pure function of (seed, epoch), so a resumed training sees the samples it would have seen. Threads
decode some batches ahead.

A picture that does not decode, or lies in a damaged chunk of its log, is left out of its batches, which are then
smaller, and named in `Loader.skipped`.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common import Skipped
from common.closeable import Closeable
from common.location import Location
from dataset.config import EpochAlteration
from dataset.epoch_alterations import EpochAlterations
from dataset.errors import UnusablePictureError
from dataset.loader.crops import Crops, Fill, prefetched
from dataset.picture_spec import ORIGINAL, PictureSpec
from dataset.prediction_targets import STEERING_ONLY, TargetName
from dataset.preprocessing import Image
from dataset.samples.sample_rows import Rows
from dataset.samples.samples_reader import Samples, Split
from recorder.log.kept_logs import bring_here

DEFAULT_BUDGET_BYTES: Final = 1 << 30

_AHEAD: Final = 256  # pictures decoded ahead, 13 MB: more fall out of the caches


@dataclass(frozen=True)
class Batch:
    pictures: Image  # (N, height, width, 3), by default (N, 128, 128, 3) BGR
    labels: NDArray[np.float32]  # (N,) steering -1..1, or (N, K): see dataset.prediction_targets

    @property
    def steering(self) -> NDArray[np.float32]:
        """(N,), -1..1."""
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
        """``rows`` are of ``samples``, which `close()` closes. For the rest see `load`."""
        if batch < 1 or threads < 0 or seed < 0 or budget_bytes < 0:
            raise ValueError(
                f"batch must be at least 1, seed, threads and budget_bytes at least 0:"
                f" {batch=}, {seed=}, {threads=}, {budget_bytes=}"
            )
        self.batch = batch
        self.seed = seed
        self.threads = threads or os.cpu_count() or 1
        self.seen = seen
        self.rows: Rows = rows if isinstance(rows, Rows) else samples.rows(rows, targets)
        self.skipped = Skipped()  # each picture once, however often it was wanted
        self._samples = samples
        self._undecoded: set[int] = set()  # the pictures in `skipped`
        bring_here(samples.logs[session] for session in self.rows.sessions)
        self._crops = Crops(self.rows, samples.logs, budget_bytes, seen)
        self.alterations: EpochAlterations | None = None
        """What `epoch` does to every picture; nothing else does."""
        if alter_each_epoch:
            self.alterations = EpochAlterations(alter_each_epoch, seed, samples.settings.side_correction)
        self._at_once = 1 + max(1, _AHEAD // batch)  # batches that are worked on

    def close(self) -> None:
        self._samples.close()

    def __len__(self) -> int:
        """Samples in an epoch."""
        return len(self.rows)

    @property
    def batches(self) -> int:
        """Batches in an epoch."""
        return -(-len(self) // self.batch)

    @property
    def pictures(self) -> int:
        """Different pictures that the samples show."""
        return len(self.rows.session)

    def order(self, epoch: int) -> NDArray[np.int64]:
        """The order of the samples in an epoch: every one once."""
        return self._order(epoch).astype(np.int64)

    def _order(self, epoch: int) -> NDArray[np.uint32]:
        """The same in half of the memory."""
        return np.random.default_rng((self.seed, epoch)).permutation(np.arange(len(self), dtype=np.uint32))

    def parts(self, epoch: int, start_batch: int = 0) -> Iterator[NDArray[np.int64]]:
        """The samples of each batch of an epoch, also those that will not decode."""
        if not 0 <= start_batch <= self.batches:
            raise ValueError(f"start_batch must be in 0 to {self.batches}, not {start_batch}")
        return self._parts(self._order(epoch), start_batch)

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[Batch]:
        """The batches of an epoch in their shuffled order, from `start_batch` on; the last one may be smaller, and
        so is one with pictures that do not decode, or lie where their log is damaged."""
        return self._batches(self.parts(epoch, start_batch), epoch)

    def in_order(self) -> Iterator[Batch]:
        """All samples once, in the order of the index (for evaluation)."""
        return self._batches(self._parts(np.arange(len(self), dtype=np.uint32), 0))

    def crops(self, samples: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], Image]]:
        """The crops (N, height, width, 3) of some samples in their order, a batch at a time, with the samples
        that they are of. None is kept here; neighbours that show the same picture share its decoding."""
        size = max(1, min(self.batch, len(self)))
        parts = np.split(samples, np.arange(size, len(samples), size))
        return self._decoded(parts, Crops(self.rows, self._samples.logs, budget_bytes=0, spec=self.seen))

    @property
    def decoded(self) -> NDArray[np.bool_]:
        """True for samples (N,) whose picture decodes, or was not read yet."""
        return ~np.isin(self.rows.picture, list(self._undecoded))

    def pictures_of(self, samples: NDArray[np.int64]) -> Image:
        """The pictures (N, height, width, 3) of N samples that decode, at most a batch of them."""
        ((_, pictures),) = self._decoded([samples], self._crops)
        return pictures

    def _parts(self, order: NDArray[np.uint32], start_batch: int) -> Iterator[NDArray[np.int64]]:
        for start in range(start_batch * self.batch, len(order), self.batch):
            yield order[start : start + self.batch].astype(np.int64)

    def labels(self, samples: NDArray[np.int64], epoch: int | None = None) -> NDArray[np.float32]:
        """The labels of samples, those of their altered pictures in an epoch."""
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
        """The samples of each part that decode, and their pictures; the others are skipped."""
        fill: Fill = crops.fill
        if epoch is not None and self.alterations is not None:
            fill = partial(crops.fill, altered=partial(self.alterations.alter, epoch))
        for part, pictures, failed in prefetched(
            parts, fill, self.seen, threads=self.threads, at_once=self._at_once
        ):
            if failed:
                self._skip(failed)
                is_decoded = ~np.isin(part, list(failed))
                part, pictures = part[is_decoded], pictures[is_decoded]
            yield part, pictures

    def _skip(self, failed: Mapping[int, UnusablePictureError]) -> None:
        for sample, error in failed.items():
            number = int(self.rows.picture[sample])
            if number not in self._undecoded:
                self._undecoded.add(number)
                self.skipped.add(error.kind, self._crops.name(number))


def load(
    index: Location | str,
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
    """The samples of a split of `index`, in batches of `batch`.

    `budget_bytes` is how much memory decoded crops may take (49 KB each); `threads` decode (0: one for each core);
    `driving_view` leaves only what the car sees itself (`Samples.driving_view`); `seen` is what a network sees,
    `targets` what it learns. `epoch` alters every picture by `alter_each_epoch`, drawn anew in every epoch.
    Raises DatasetError if there is no index, if it is damaged or does not fit its logs.
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
