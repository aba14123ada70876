"""Batches on the device that trains.

On a CPU, batches come directly from the loader. On a GPU, all crops are kept in its memory if they fit into half
of the free memory. Each picture is then decoded only once, which is the slowest part. If they do not fit, each
batch is copied while the one before is learnt. All three give the same samples in the same order, so a GPU learns
the same as a CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from dataset import Batch, Loader
from dataset.epoch_alterations import Drawn
from dataset.loader.crops import Numbers, count_crops, different_crops
from model.evaluation.predict import as_input
from model.training.altered_on_device import AlteredOnDevice

Advance = Callable[[int], object]


class Batches(Protocol):
    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
        """The batches of an epoch from `start_batch` on: pictures (N, 3, height, width) uint8 in channels_last
        memory, and labels (N,) or (N, K) float32, both on the device. A batch may be smaller than others, or
        empty."""


def make_batches(
    loader: Loader, device: torch.device, budget_bytes: int | None = None, advance: Advance = lambda pictures: None
) -> Batches:
    """The batches of a loader on a device.

    Crops may take `budget_bytes` of a GPU's memory; by default, half of the free memory. `advance` is called with
    the number of pictures read since the last call, without those that do not decode. Raises DatasetError or
    LogError if the index or a log is damaged.
    """
    if device.type == "cpu":
        return HostBatches(loader)
    can_alter = loader.alterations is None or loader.seen.channels == "BGR"  # the device alters only BGR
    budget = _free_bytes(device) // 2 if budget_bytes is None else budget_bytes
    if can_alter and needed_bytes(loader) <= budget:
        return DeviceBatches(loader, device, advance)
    return PinnedBatches(loader, device)


def needed_bytes(loader: Loader) -> int:
    """Bytes on a device for all crops of a loader, and for the order and the labels of an epoch."""
    return count_crops(loader.rows) * loader.seen.size_bytes + len(loader) * 16


class HostBatches:
    """Batches in the loader's own memory, without a copy."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
        batches = self._loader.epoch(epoch, start_batch)
        return ((as_input(batch.pictures), torch.from_numpy(batch.labels)) for batch in batches)


class PinnedBatches:
    """Copies each batch to the device while the one before is learnt, and keeps nothing else on the device."""

    def __init__(self, loader: Loader, device: torch.device) -> None:
        self._loader = loader
        self._device = device
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None  # type: ignore[no-untyped-call]

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
        ahead: _Copy | None = None
        for batch in self._loader.epoch(epoch, start_batch):
            following = _Copy(batch, self._device, self._stream)
            if ahead is not None:
                yield ahead.arrived()
            ahead = following
        if ahead is not None:
            yield ahead.arrived()


class _Copy:
    """A batch on its way to a device."""

    def __init__(self, batch: Batch, device: torch.device, stream: torch.cuda.Stream | None) -> None:
        pictures, labels = as_input(batch.pictures), torch.from_numpy(batch.labels)
        self._event: torch.cuda.Event | None = None
        # Only copies from pinned memory are asynchronous. PyTorch keeps that memory until the stream has finished
        # the copy, although its tensors are deleted before.
        if stream is not None:
            pictures, labels = pictures.pin_memory(), labels.pin_memory()
        with torch.cuda.stream(stream):  # without a stream, this does nothing
            self._labels = labels.to(device, non_blocking=True)
            self._pictures = pictures.to(device, non_blocking=True)
        if stream is not None:
            self._event = stream.record_event()

    def arrived(self) -> tuple[Tensor, Tensor]:
        if self._event is not None:
            self._event.synchronize()
            for tensor in (self._pictures, self._labels):
                tensor.record_stream(torch.cuda.current_stream(tensor.device))
        return self._pictures, self._labels


class DeviceBatches:
    """Keeps every crop on the device once, and picks, mirrors and alters the batches on the device."""

    def __init__(self, loader: Loader, device: torch.device, advance: Advance = lambda pictures: None) -> None:
        """Reads all pictures. Raises DatasetError or LogError if the index or a log is damaged."""
        self._loader = loader
        self._device = device
        rows = loader.rows
        samples, self._crop = different_crops(rows)
        self._flip = rows.flip != rows.flip[samples][self._crop]
        is_new_picture = np.diff(rows.picture[samples], prepend=-1) != 0
        self._crops = torch.empty((len(samples), *loader.seen.shape), dtype=torch.uint8, device=device)
        self._is_decoded = np.zeros(len(samples), np.bool_)
        for part, crops in loader.crops(samples):
            numbers = self._crop[part]
            self._crops.index_copy_(0, torch.from_numpy(numbers).to(device), torch.from_numpy(crops).to(device))
            self._is_decoded[numbers] = True
            advance(int(np.count_nonzero(is_new_picture[numbers])))
        self._thread = ThreadPoolExecutor(1)
        self._ahead: dict[tuple[int, int], Future[tuple[list[Numbers], Drawn | None]]] = {}

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
        of_epoch = self._ahead.pop((epoch, start_batch), None) or self._prepared(epoch, start_batch)
        return self._batches(*of_epoch.result(), epoch)

    def _prepared(self, epoch: int, start_batch: int = 0) -> Future[tuple[list[Numbers], Drawn | None]]:
        """The samples of each batch, and the alterations of them all, which a GPU need not wait for if another
        thread draws them an epoch ahead."""
        return self._thread.submit(self._draw, epoch, start_batch)

    def _draw(self, epoch: int, start_batch: int) -> tuple[list[Numbers], Drawn | None]:
        parts = [part[self._is_decoded[self._crop[part]]] for part in self._loader.parts(epoch, start_batch)]
        alterations = self._loader.alterations
        if alterations is None:
            return parts, None
        height, width, _ = self._loader.seen.shape
        return parts, alterations.draw(epoch, _joined(parts), height, width)

    def _batches(self, parts: list[Numbers], drawn: Drawn | None, epoch: int) -> Iterator[tuple[Tensor, Tensor]]:
        # Send all data of the epoch at once: a copy in its middle would make the host wait for the GPU.
        samples = _joined(parts)
        columns = self._crop[samples], self._flip[samples], self._loader.labels(samples, epoch)
        crop, flip, labels = (torch.from_numpy(column).to(self._device) for column in columns)
        height, width, _ = self._loader.seen.shape
        altered = None if drawn is None else AlteredOnDevice(drawn, height, width, self._device)
        self._ahead = {(epoch + 1, 0): self._prepared(epoch + 1)}
        end = 0
        for part in parts:
            start, end = end, end + len(part)
            pictures = self._crops.index_select(0, crop[start:end])
            pictures = torch.where(flip[start:end, None, None, None], pictures.flip(2), pictures)
            if altered is not None:
                pictures = altered.pictures(pictures, start)
            yield pictures.permute(0, 3, 1, 2), labels[start:end]


def _joined(parts: list[Numbers]) -> Numbers:
    return np.concatenate([*parts, np.zeros(0, np.int64)])


def _free_bytes(device: torch.device) -> int:
    """Free memory of a device in bytes; 0 if unknown."""
    return torch.cuda.mem_get_info(device)[0] if device.type == "cuda" else 0
