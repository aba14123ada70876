"""Batches on the device that trains.

On a CPU, batches come directly from the loader. On a GPU, all crops are kept in its memory if they fit into half
of the free memory. Each picture is then decoded only once, which is the slowest part. If they do not fit, each
batch is copied while the one before is learnt. All give the same samples in the same order, so a GPU learns the
same as a CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from dataset import Batch, Loader
from dataset.alterations import NOISE_LEVEL, Drawn, Floats, noise_of
from dataset.loader.crops import Numbers, count_crops, different_crops
from model.evaluation.predict import as_input

Advance = Callable[[int], object]


def make_batches(
    loader: Loader, device: torch.device, budget_bytes: int | None = None, advance: Advance = lambda pictures: None
) -> StreamedBatches | KeptBatches:
    """The batches of a loader on a device.

    Crops may take `budget_bytes` of a GPU's memory; by default, half of the free memory. `advance` is called with
    the number of pictures read since the last call, without those that do not decode. Raises DatasetError or
    LogError if the index or a log is damaged.
    """
    can_alter = loader.alterations is None or loader.seen.channels == "BGR"  # the device alters only BGR
    if device.type != "cpu" and can_alter:
        budget = _free_bytes(device) // 2 if budget_bytes is None else budget_bytes
        if needed_bytes(loader) <= budget:
            return KeptBatches(loader, device, advance)
    return StreamedBatches(loader, device)


def needed_bytes(loader: Loader) -> int:
    """Bytes on a device for all crops of a loader, and for the order and the labels of an epoch."""
    return count_crops(loader.rows) * loader.seen.size_bytes + len(loader) * 16


class StreamedBatches:
    """Batches of the loader, read anew in every epoch. On a processor they stay in the loader's own memory. To
    another device, each is copied while the one before is learnt, and nothing else is kept there."""

    def __init__(self, loader: Loader, device: torch.device) -> None:
        self._loader = loader
        self._device = device
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None  # type: ignore[no-untyped-call]

    def epoch(self, epoch: int, start_batch: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
        """The batches of an epoch from `start_batch` on: pictures (N, 3, height, width) uint8 in channels_last
        memory, and labels (N,) or (N, K) float32, both on the device. A batch may be smaller than others, or
        empty."""
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


class KeptBatches:
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
        """As those of `StreamedBatches`."""
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


class AlteredOnDevice:
    """Alters the pictures (N, height, width, 3) of an epoch on their device."""

    def __init__(self, drawn: Drawn, height: int, width: int, device: torch.device) -> None:
        def sent(values: Any) -> Tensor:
            return torch.from_numpy(np.asarray(values, np.float32)).to(device)

        self._size = height, width
        self._row, self._column = torch.arange(height, device=device)[:, None], torch.arange(width, device=device)
        self._places = sent(_places(drawn.matrix, height, width)) if drawn.matrix is not None else None
        self._colours = sent(drawn.colours) if drawn.colours is not None else None
        self._shade = sent(drawn.shade) if drawn.shade is not None else None
        self._strip = sent(drawn.strip[:, :, 0])
        self._box = sent(drawn.box) if drawn.box is not None else None
        self._noise = sent(drawn.noise / NOISE_LEVEL) if drawn.noise is not None else None
        if self._noise is not None:
            size = height * width * 3
            self._piece = torch.from_numpy(drawn.piece).to(device)
            self._pieces = (sent(noise_of(size)) - 128).unfold(0, size, 1)  # a view

    def pictures(self, pictures: Tensor, start: int) -> Tensor:
        """The altered BGR pictures (N, height, width, 3) uint8; the first is the epoch's sample `start`."""
        part = slice(start, start + len(pictures))
        height, width = self._size
        altered = pictures.permute(0, 3, 1, 2).float()
        if self._places is not None:
            right, down, shift = self._places[part, None, None].unbind(4)
            grid = right * self._column[:, None] + (down * self._row[:, :, None] + shift)
            altered = functional.grid_sample(altered, grid, padding_mode="border", align_corners=False)
        if self._colours is not None:
            colours = self._colours[part][:, :, :, None, None]
            mixed = colours[:, :, 3]
            for colour in range(3):
                mixed = torch.addcmul(mixed, colours[:, :, colour], altered[:, colour, None])
            altered = mixed.clamp_(0, 255)
        if self._shade is not None:
            top_left, top_right, bottom_right, bottom_left = self._strip[part].T[:, :, None, None]
            down = self._row / max(1, height - 1)
            is_dark = self._column >= torch.lerp(top_left, bottom_left, down)
            is_dark &= self._column <= torch.lerp(top_right, bottom_right, down)
            light = torch.where(is_dark, self._shade[part, None, None], 1)
            altered = altered * light[:, None]
        if self._box is not None:
            left, top, right, bottom, level = self._box[part].T[:, :, None, None]
            is_blank = (self._column >= left) & (self._column < right)
            is_blank = is_blank & (self._row >= top) & (self._row < bottom)
            altered = torch.where(is_blank[:, None], level[:, None], altered)
        if self._noise is not None:
            noise = self._pieces[self._piece[part]].view(-1, height, width, 3).permute(0, 3, 1, 2)
            altered = torch.addcmul(altered, self._noise[part, None, None, None], noise)
        altered = altered.round_().clamp_(0, 255).permute(0, 2, 3, 1)
        return altered.to(torch.uint8, memory_format=torch.contiguous_format)


def _places(matrix: Floats, height: int, width: int) -> Floats:
    """The matrices (N, 2, 3), with their results in PyTorch's coordinates: -1 to 1 between the outer edges of the
    pixels."""
    size = np.array([width, height])
    places = matrix * (2 / size)[:, None]
    places[:, :, 2] += 1 / size - 1
    return places
