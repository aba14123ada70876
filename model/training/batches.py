"""Batches on the device that trains, from wherever the pictures are kept.

On a CPU they come straight out of the loader. On a GPU all crops lie in its memory, if they fit into half of what
is free: decoding, the slowest part, is then done once. If they do not fit, each batch is copied while the one
before it is learnt. All give the same samples in the same order, so that a GPU learns what a CPU would.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from common import Skipped
from dataset import Batch, Loader
from dataset.loader.crops import CROP_BYTES, CROP_SHAPE
from model.evaluation.predict import as_input
from model.training.device_augment import MASK_BYTES, Alterations

Advance = Callable[[int], object]


class Batches(Protocol):
    """Where training gets its samples from."""

    def __len__(self) -> int:
        """Samples in an epoch, those of all ranks together."""

    @property
    def batches(self) -> int:
        """Batches in an epoch, for every rank the same number."""

    @property
    def skipped(self) -> Skipped:
        """Pictures that do not decode, as far as they were met: they are left out of their batches."""

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
        """The batches of an epoch from `start_batch` on: pictures (N, 3, 128, 128) uint8 in channels_last memory,
        and steering (N,) float32, both on the device. Any may be smaller than the others, or empty."""


def make_batches(
    loader: Loader,
    device: torch.device,
    budget_bytes: int | None = None,
    advance: Advance = lambda pictures: None,
) -> Batches:
    """The batches of a loader on a device.

    `budget_bytes` of a GPU's memory may be taken for crops; without it, half of what is free. `advance` is told
    how many of `loader.pictures` have been read since the last call; those that do not decode are never told.
    Raises DatasetError or LogError where the index or a log is damaged.
    """
    if device.type == "cpu":
        return HostBatches(loader)
    budget = _free_bytes(device) // 2 if budget_bytes is None else budget_bytes
    if needed_bytes(loader) <= budget:
        return DeviceBatches(loader, device, advance)
    return PinnedBatches(loader, device)


def needed_bytes(loader: Loader) -> int:
    """Memory that all crops of a loader take on a device, with what their alterations need."""
    is_shaded = np.array(["shadow" in names for names in loader.rows.alterations], np.bool_)
    shaded = int(np.count_nonzero(is_shaded[loader.rows.alteration])) if len(loader) else 0
    return loader.pictures * CROP_BYTES + shaded * MASK_BYTES + len(loader) * 16


class _OfLoader:
    """What all batches take from their loader."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def __len__(self) -> int:
        return len(self._loader)

    @property
    def batches(self) -> int:
        return self._loader.batches

    @property
    def skipped(self) -> Skipped:
        return self._loader.skipped


class HostBatches(_OfLoader):
    """The loader's own memory, nothing copied."""

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
        batches = self._loader.epoch(epoch, start_batch)
        return ((as_input(batch.pictures), torch.from_numpy(batch.steering)) for batch in batches)


class PinnedBatches(_OfLoader):
    """Each batch is copied to the device while the one before it is learnt; nothing else is kept there."""

    def __init__(self, loader: Loader, device: torch.device) -> None:
        super().__init__(loader)
        self._device = device
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None  # type: ignore[no-untyped-call]
        if self._stream is not None:
            loader.use_memory(_pinned)  # only out of such memory does a GPU copy by itself

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
        return self._one_ahead(self._loader.epoch(epoch, start_batch))

    def _one_ahead(self, batches: Iterator[Batch]) -> Iterator[tuple[Tensor, Tensor]]:
        ahead: _Copy | None = None
        for batch in batches:
            following = _Copy(batch, self._device, self._stream)
            if ahead is not None:
                yield ahead.arrived()
            ahead = following
        if ahead is not None:
            yield ahead.arrived()


class _Copy:
    """A batch on its way to a device."""

    def __init__(self, batch: Batch, device: torch.device, stream: torch.cuda.Stream | None) -> None:
        self._batch = batch  # its memory must not be used again before the copy is done
        self._event: torch.cuda.Event | None = None
        with torch.cuda.stream(stream):  # without a stream, this does nothing
            self._steering = torch.from_numpy(batch.steering).to(device, non_blocking=True)
            self._pictures = as_input(batch.pictures).to(device, non_blocking=True)
        if stream is not None:
            self._event = stream.record_event()

    def arrived(self) -> tuple[Tensor, Tensor]:
        if self._event is not None:
            self._event.synchronize()
            for tensor in (self._pictures, self._steering):
                tensor.record_stream(torch.cuda.current_stream(tensor.device))
        return self._pictures, self._steering


class DeviceBatches(_OfLoader):
    """Every crop lies on the device, once; a batch is picked out of them, mirrored and altered there."""

    def __init__(self, loader: Loader, device: torch.device, advance: Advance = lambda pictures: None) -> None:
        """Reads all pictures. Raises DatasetError or LogError where the index or a log is damaged."""
        super().__init__(loader)
        self._device = device
        self._alterations = Alterations(loader.rows, device)
        self._crops = torch.empty((loader.pictures, *CROP_SHAPE), dtype=torch.uint8, device=device)
        self._is_decoded = np.zeros(loader.pictures, np.bool_)
        for numbers, crops in loader.crops():
            self._crops.index_copy_(0, torch.from_numpy(numbers).to(device), torch.from_numpy(crops).to(device))
            self._is_decoded[numbers] = True
            advance(len(numbers))

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
        rows = self._loader.rows
        parts = [part[self._is_decoded[rows.picture[part]]] for part in self._loader.parts(epoch, start_batch)]
        return self._epoch(parts)

    def _epoch(self, parts: list[NDArray[np.int64]]) -> Iterator[tuple[Tensor, Tensor]]:
        # All that the epoch needs is sent at once: a copy in its middle would make the host wait for the GPU.
        rows = self._loader.rows
        samples = np.concatenate([*parts, np.zeros(0, np.int64)])
        picture, flip, steering = (
            torch.from_numpy(column[samples]).to(self._device) for column in (rows.picture, rows.flip, rows.label)
        )
        steps = self._alterations.steps(parts)
        end = 0
        for number, part in enumerate(parts):
            start, end = end, end + len(part)
            pictures = self._crops.index_select(0, picture[start:end])
            pictures = torch.where(flip[start:end, None, None, None], pictures.flip(2), pictures)
            self._alterations.apply(steps, number, pictures)
            yield pictures.permute(0, 3, 1, 2), steering[start:end]


def _pinned(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    memory: NDArray[np.uint8] = torch.empty(shape, dtype=torch.uint8, pin_memory=True).numpy()
    return memory


def _free_bytes(device: torch.device) -> int:
    """Free memory of a device; 0 where nobody tells."""
    return torch.cuda.mem_get_info(device)[0] if device.type == "cuda" else 0
