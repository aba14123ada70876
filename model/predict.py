"""What a network says of pictures; training, evaluation and driving ask alike."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray

from dataset import Loader
from model.network import SteeringNetwork


@torch.inference_mode()
def predict(
    network: SteeringNetwork, loader: Loader, advance: Callable[[int], object] = lambda samples: None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The network's steering and the recorded one, each (N,), for a loader's samples in their order; float32
    arithmetic on the network's device. `advance` is told how many samples are done since the last call."""
    network.eval()
    device = next(network.parameters()).device
    predicted, recorded = [np.zeros(0)], [np.zeros(0)]
    for batch in loader.in_order():
        predicted.append(network(as_input(batch.pictures).to(device)).cpu().numpy().astype(np.float64))
        recorded.append(batch.steering.astype(np.float64))
        advance(len(batch.steering))
    return np.concatenate(predicted), np.concatenate(recorded)


def as_input(pictures: NDArray[np.uint8]) -> torch.Tensor:
    """Pictures (N, 128, 128, 3) as the network's (N, 3, 128, 128), without a copy: this is channels_last."""
    return torch.from_numpy(pictures).permute(0, 3, 1, 2)
