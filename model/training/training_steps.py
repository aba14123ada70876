"""The training steps of a network. On a GPU, a step is recorded once as a CUDA graph, then replayed.

Python starts the operations of a step one by one, more slowly than a fast GPU calculates them: on an H200, a step
of `original` took 8.7 instead of 4.1 ms.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Final

import torch
from torch import Tensor

from common.named_function import in_one_line
from model.adam import Adam
from model.device import Machine
from model.network.picture_network import PictureNetwork
from model.network.replayed import usable_if_failed
from model.training.step import training_step

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


def record(calculate: Callable[[], Tensor], device: torch.device) -> tuple[Callable[[], None], Tensor]:
    """Record a calculation on the GPU `device` without running it. Returns a function that runs it, and the tensor
    that then holds its result. Raises RuntimeError, or what `calculate` raises, if it cannot be recorded. The GPU
    stays usable."""
    graph, pool = torch.cuda.CUDAGraph(), torch.cuda.graph_pool_handle()
    with (
        torch.cuda.device(device),  # on another GPU, nothing would be recorded, and no error raised
        usable_if_failed(graph, pool, device),
        # other threads may use the GPU meanwhile
        torch.cuda.graph(graph, pool=pool, capture_error_mode="thread_local"),
    ):
        result = calculate()
    return graph.replay, result
