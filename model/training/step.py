"""One training step: the mean squared error of a batch, its gradient, and a step of Adam."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn
from torch.nn import functional

from model.adam import Adam


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
