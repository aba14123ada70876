"""Batches for training, straight out of the logs.

The order is a pure function of (seed, epoch), so a resumed training sees the samples it would have seen.
Pictures are read by byte range, decoded on threads (OpenCV releases Python's lock), and kept in memory as crops
as long as they fit the budget; one batch is prepared while the last one is being used.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dataset.alter import alter
from dataset.errors import DatasetError
from dataset.frames import METADATA_KEY
from dataset.index import SAMPLES_NAME
from dataset.preprocess import SIZE_PX, Image, decode, preprocess
from recorder import Log

Split = Literal["train", "validation"]

DEFAULT_BUDGET_BYTES = 1 << 30


@dataclass(frozen=True)
class Batch:
    pictures: Image  # (N, 128, 128, 3) BGR
    steering: NDArray[np.float32]  # (N,), -1..1


class Samples:
    """The samples of one index, and the logs that hold their pictures.

    Raises DatasetError if there is no index, or if a log is not the one that was indexed.
    """

    def __init__(self, index: Path) -> None:
        self.path = index / SAMPLES_NAME
        try:
            self.table: pa.Table = pq.read_table(self.path)
            self.metadata = json.loads(self.table.schema.metadata[METADATA_KEY])
            sources: dict[str, dict[str, str]] = self.metadata["logs"]
        except FileNotFoundError:
            raise DatasetError(f"{self.path}: no index; build it with `bc-index`") from None
        except (OSError, ValueError, KeyError, TypeError, pa.ArrowException) as error:
            raise DatasetError(f"{self.path}: damaged ({error}); build it again with `bc-index`") from None
        self.logs: dict[str, Log] = {}
        try:
            for session, source in sources.items():
                log = self.logs[session] = Log(index / source["log"])
                if log.fingerprint != source["fingerprint"]:
                    raise DatasetError(f"{log.path}: has changed since it was indexed; run `bc-index` again")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        for log in self.logs.values():
            log.close()

    def of_split(self, split: Split) -> pa.Table:
        return self.table.filter(pc.equal(self.table["split"], split))

    def driving_view(self, split: Split) -> pa.Table:
        """What the car itself sees: the centre camera, unmirrored and unaltered, each picture once.

        Without pictures of the centre camera, those of the others.
        """
        table = self.of_split(split)
        table = table.filter(pc.and_(pc.invert(table["flip"]), pc.invert(table["copy"])))
        center = table.filter(pc.equal(table["camera"], "center"))
        return center if len(center) else table


class Loader:
    """Batches of some rows of `Samples.table`."""

    def __init__(
        self,
        samples: Samples,
        rows: pa.Table,
        *,
        batch: int,
        seed: int = 0,
        budget_bytes: int = DEFAULT_BUDGET_BYTES,
    ) -> None:
        """``budget_bytes`` is how much memory decoded crops may take (49 KB each)."""
        self.batch = batch
        self.seed = seed
        self._label = rows["label"].to_numpy().astype(np.float32)
        self._flip = rows["flip"].to_numpy()
        self._alteration: list[str] = rows["alteration"].to_pylist()
        self._alteration_seed = rows["seed"].to_numpy()
        places = (rows[name].to_pylist() for name in ("session", "offset", "length", "chunk"))
        self._where = list(zip(*places, strict=True))
        self._logs = samples.logs
        # Mirror images and copies share their original's picture: it is decoded and kept once.
        slots: dict[tuple[str, int, int, int], int] = {}
        self._slot = np.array([slots.setdefault(where, len(slots)) for where in self._where], np.int64)
        kept = min(len(slots), budget_bytes // (SIZE_PX * SIZE_PX * 3))
        self._crops = np.empty((kept, SIZE_PX, SIZE_PX, 3), np.uint8)
        self._is_kept = np.zeros(kept, np.bool_)
        self._threads = os.cpu_count() or 1

    def __len__(self) -> int:
        return len(self._label)

    def order(self, epoch: int) -> NDArray[np.int64]:
        """Which sample comes when, in an epoch: every one once."""
        return np.random.default_rng((self.seed, epoch)).permutation(len(self))

    def epoch(self, epoch: int) -> Iterator[Batch]:
        """The batches of an epoch in their shuffled order; the last one may be smaller."""
        return self._batches(self.order(epoch))

    def in_order(self) -> Iterator[Batch]:
        """All samples once, in the order of the index (for evaluation)."""
        return self._batches(np.arange(len(self)))

    def _batches(self, order: NDArray[np.int64]) -> Iterator[Batch]:
        parts = [order[i : i + self.batch] for i in range(0, len(order), self.batch)]
        with ThreadPoolExecutor(1) as ahead, ThreadPoolExecutor(self._threads) as pool:
            following: Future[Batch] | None = None
            for i in range(len(parts)):
                current = following or ahead.submit(self._assemble, parts[i], pool)
                following = ahead.submit(self._assemble, parts[i + 1], pool) if i + 1 < len(parts) else None
                yield current.result()

    def _assemble(self, rows: NDArray[np.int64], pool: ThreadPoolExecutor) -> Batch:
        pictures = np.empty((len(rows), SIZE_PX, SIZE_PX, 3), np.uint8)
        size = -(-len(rows) // self._threads)
        jobs = [
            pool.submit(self._fill, pictures[i : i + size], rows[i : i + size]) for i in range(0, len(rows), size)
        ]
        for job in jobs:
            job.result()
        return Batch(pictures, self._label[rows])

    def _fill(self, pictures: Image, rows: NDArray[np.int64]) -> None:
        for picture, row in zip(pictures, rows.tolist(), strict=True):
            crop = self._crop(row)
            if self._flip[row]:
                crop = crop[:, ::-1]
            if self._alteration[row]:
                crop = alter(np.ascontiguousarray(crop), self._alteration[row], int(self._alteration_seed[row]))
            picture[:] = crop

    def _crop(self, row: int) -> Image:
        slot = int(self._slot[row])
        if slot < len(self._crops) and self._is_kept[slot]:
            kept: Image = self._crops[slot]
            return kept
        session, offset, length, chunk = self._where[row]
        log = self._logs[session]
        try:
            crop = preprocess(decode(log.read(offset, length, chunk)))
        except ValueError as error:
            raise DatasetError(f"{log.path}: the picture at byte {offset}: {error}") from None
        if slot < len(self._crops):
            self._crops[slot] = crop
            self._is_kept[slot] = True  # set last: another thread may look at any moment
        return crop
