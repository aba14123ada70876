"""One training step: the mean squared error of a batch, its gradient, and a step of Adam. On a GPU, a step is
recorded once as a CUDA graph, then replayed.

Python starts the operations of a step one by one, more slowly than a fast GPU calculates them: on an H200, a step
of `original` took 8.7 instead of 4.1 ms.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from common.named_function import in_one_line
from model.adam import Adam
from model.device import Machine
from model.network.picture_network import PictureNetwork
from model.network.replayed import record


def training_step(
    network: nn.Module,
    optimizer: Adam,
    pictures: Tensor,
    labels: Tensor,
    *,
    dtype: torch.dtype,
    micro_batch: int,
    batch: int | None = None,
    weights: Tensor | None = None,
    least: int = 1,
) -> Tensor:
    """Train on pictures (N, 3, height, width) uint8 and their labels, steering (N,) or targets (N, K), all on the
    network's device. Returns the squared error before the step, summed over the samples.

    With several targets, it is the sum over the targets, weighted by `weights` (K,).

    The gradient is summed over parts of `micro_batch` samples and divided by `batch`, by default N. A training
    gives a `batch` that also counts samples that do not decode. A last part of fewer than `least` samples joins
    the part before it.
    """
    optimizer.zero_grad()
    squared_error = torch.zeros((), device=labels.device)
    scale = 1 / (batch or len(labels))
    sizes = [len(part) for part in torch.split(labels, micro_batch)]
    if len(sizes) > 1 and sizes[-1] < least:
        sizes[-2:] = [sum(sizes[-2:])]
    parts = zip(torch.split(pictures, sizes), torch.split(labels, sizes), strict=True)
    kind = labels.device.type
    # around all parts, so that the weights are cast only once
    with torch.autocast(kind, dtype=dtype, enabled=dtype != torch.float32):
        for some_pictures, some_labels in parts:
            predicted = network(some_pictures)
            with torch.autocast(kind, enabled=False):
                loss = _squared_error(predicted.float(), some_labels, weights)
                (loss * scale).backward()  # type: ignore[no-untyped-call]
            squared_error += loss.detach()
    optimizer.step()
    return squared_error


def least_samples(network: nn.Module, picture: Tensor) -> int:
    """The smallest number of samples that a network learns from: 2 if its batch normalisation refuses a single
    `picture` (1, 3, height, width)."""
    if any(isinstance(layer, nn.modules.batchnorm._BatchNorm) for layer in network.modules()):
        try:
            with torch.no_grad():
                copy.deepcopy(network).train()(picture)
        except Exception:  # a ValueError of PyTorch, or one of the user's own code
            return 2
    return 1


def _squared_error(predicted: Tensor, labels: Tensor, weights: Tensor | None) -> Tensor:
    """The squared error, summed over the samples and the targets with a label."""
    if labels.dim() == 1:
        return functional.mse_loss(predicted, labels, reduction="sum")
    labels = torch.where(labels.isnan(), predicted.detach(), labels)
    squares = torch.square(predicted - labels)
    return (squares if weights is None else squares * weights).sum()


_LOGGER: Final = logging.getLogger(__name__)

_STEPS_BEFORE: Final = 3
"""Steps before the recording: libraries initialise themselves in the first ones, and Adam creates its state."""


class TrainingSteps:
    def __init__(
        self,
        network: PictureNetwork,
        optimizer: Adam,
        machine: Machine,
        batch: int,
        weights: Tensor | None,
        *,
        least: int = 1,
        can_record: bool,
    ) -> None:
        """`weights` and `least` are those of `training_step`. Only steps of `batch` samples are recorded, and
        none unless `can_record`: a user's own network may wait for the GPU, which no recording may. GPUs of AMD
        record none: they were not tried."""
        self._network = network
        self._optimizer = optimizer
        self._machine = machine
        self._batch = batch
        self._weights = weights
        self._least = least
        self._can_record = can_record and machine.device.type == "cuda" and torch.version.hip is None
        self._taken = 0
        self._recorded: Callable[[Tensor, Tensor], Tensor] | None = None

    def take(self, pictures: Tensor, labels: Tensor, batch: int) -> Tensor:
        """Take a `training_step` on a batch, and return its squared error. The next step may overwrite it."""
        if not self._can_record or not len(labels) == batch == self._batch:
            return self._take(pictures, labels, batch)
        if self._recorded is None:
            self._taken += 1
            if self._taken <= _STEPS_BEFORE:
                return self._take(pictures, labels, batch)
            try:
                self._recorded = self._record(pictures, labels)
            except Exception as error:  # it holds the memory of the recording until the block ends
                self._can_record = False
                _LOGGER.warning("the GPU records no training step (%s), so training is slower", in_one_line(error))
        if self._recorded is None:
            return self._take(pictures, labels, batch)
        return self._recorded(pictures, labels)

    def _take(self, pictures: Tensor, labels: Tensor, batch: int) -> Tensor:
        return training_step(
            self._network,
            self._optimizer,
            pictures,
            labels,
            dtype=self._machine.dtype,
            micro_batch=self._machine.micro_batch,
            batch=batch,
            weights=self._weights,
            least=self._least,
        )

    def _record(self, pictures: Tensor, labels: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
        """A function that takes a step on any batch of this shape. It trains the same network."""
        kept_pictures, kept_labels = torch.empty_like(pictures), torch.empty_like(labels)
        replay, squared_error = record(
            lambda: self._take(kept_pictures, kept_labels, self._batch), self._machine.device
        )

        def take(pictures: Tensor, labels: Tensor) -> Tensor:
            kept_pictures.copy_(pictures)
            kept_labels.copy_(labels)
            replay()
            return squared_error

        return take
