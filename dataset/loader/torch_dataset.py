"""Single samples, for PyTorch's own DataLoader.

    with SamplesDataset(Path("index"), "train") as samples:
        DataLoader(samples, batch_size=256, shuffle=True, num_workers=8)

`load` gives the same pictures faster, without worker processes. This module does not import PyTorch: a DataLoader
only needs the length and the items of a data set.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from common.closeable import Closeable
from common.location import local_path
from common.untrusted import real_path
from dataset.loader.crops import Crops
from dataset.picture_spec import ORIGINAL, PictureSpec
from dataset.prediction_targets import STEERING_ONLY, TargetName
from dataset.preprocessing import Image
from dataset.samples.samples_reader import Samples, Split, open_logs


class SamplesDataset(Closeable):
    """A split of an index. Item i is (picture `seen.shape` uint8, steering -1..1 float32), mirrored and altered as
    in the index. With other targets, the second is (K,): see dataset.prediction_targets.

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
