"""One step of the optimizer: mean squared error of a batch, its gradient, Adam."""

from __future__ import annotations

import contextlib

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.parallel import DistributedDataParallel

from model.adam import Adam


def make_optimizer(network: nn.Module, rate: float) -> Adam:
    """Adam over all the network's parameters, on their device."""
    return Adam(network.parameters(), rate)


def training_step(
    network: nn.Module,
    optimizer: Adam,
    pictures: Tensor,
    steering: Tensor,
    *,
    dtype: torch.dtype,
    micro_batch: int,
    batch: int | None = None,
    ranks: int = 1,
) -> Tensor:
    """Train on pictures (N, 3, height, width) uint8 and their steering (N,), on the network's device, and return
    the squared error, summed over these samples, before the step.

    The gradient is summed over parts of `micro_batch` samples. With several `ranks`, these samples are a part of
    `batch`, and the network is a DistributedDataParallel, which averages the ranks' gradients.
    """
    optimizer.zero_grad()
    squared_error = torch.zeros((), device=steering.device)
    scale = ranks / (batch or len(steering))
    parts = list(zip(torch.split(pictures, micro_batch), torch.split(steering, micro_batch), strict=True))
    kind = steering.device.type
    # around all parts: the weights are cast once for all of them
    with torch.autocast(kind, dtype=dtype, enabled=dtype != torch.float32):
        for number, (some_pictures, some_steering) in enumerate(parts, 1):
            with _gradient_exchange(network, is_last=number == len(parts)):
                predicted = network(some_pictures)
                with torch.autocast(kind, enabled=False):
                    loss = functional.mse_loss(predicted.float(), some_steering, reduction="sum")
                    (loss * scale).backward()  # type: ignore[no-untyped-call]
            squared_error += loss.detach()
    optimizer.step()
    return squared_error


def _gradient_exchange(network: nn.Module, *, is_last: bool) -> contextlib.AbstractContextManager[None]:
    """Let ranks exchange their gradients once a batch, with its last part."""
    if isinstance(network, DistributedDataParallel) and not is_last:
        context: contextlib.AbstractContextManager[None] = network.no_sync()
        return context
    return contextlib.nullcontext()
