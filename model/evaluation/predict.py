"""Predictions of networks for pictures, the same way in training, evaluation and driving."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from common.memory_allocator import keep_freed_memory
from dataset import Loader
from dataset.preprocess import Image
from model.errors import RunError
from model.network.original import SteeringNetwork
from model.network.visual_backprop import predict_with_attention
from model.progress_bar import open_bar, progress_task
from model.runs.run_folder import load_config, load_network

BATCH: Final = 64  # what stays in a processor's cache

AttentionCallback = Callable[[int, NDArray[np.int64], Image, NDArray[np.float32]], object]
"""Called with where a network looks: which run (0, 1 ...), numbers of pictures (N,), their crops
(N, 128, 128, 3) BGR, and the maps (N, 128, 128), 0..1."""


@torch.inference_mode()
def predict(
    network: SteeringNetwork, loader: Loader, advance: Callable[[int], object] = lambda samples: None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The network's steering and the recorded one, each (N,), for a loader's samples in their order; float32
    arithmetic on the network's device. `advance` gets the number of samples done since the last call."""
    network.eval()
    device = next(network.parameters()).device
    predicted, recorded = [np.zeros(0)], [np.zeros(0)]
    for batch in loader.in_order():
        predicted.append(network(as_input(batch.pictures).to(device)).cpu().numpy().astype(np.float64))
        recorded.append(batch.steering.astype(np.float64))
        advance(len(batch.steering))
    return np.concatenate(predicted), np.concatenate(recorded)


@torch.inference_mode()
def predict_crops(
    runs: Sequence[Path],
    batches: Iterable[tuple[NDArray[np.int64], Image]],
    count: int,
    on_attention: AttentionCallback | None = None,
    on_batch: Callable[[], object] = lambda: None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The steering of each run's network for `count` pictures, (runs, count), and of which pictures there was a
    crop (count,); with a progress bar. `batches` gives numbers of pictures and their crops. `on_batch` is called
    after each, and may raise what ends it.

    Raises RunError if a run is incomplete or damaged, or its network gives no number.
    """
    networks = []
    for run in runs:
        load_config(run)  # refuses a run of another preprocessing
        networks.append(load_network(run).to(memory_format=torch.channels_last))  # type: ignore[call-overload]
    keep_freed_memory()
    predicted, is_decoded = np.zeros((len(runs), count)), np.zeros(count, np.bool_)
    with open_bar(is_shown=True) as bar, progress_task(bar, "frames", count) as advance:
        for numbers, crops in batches:
            is_decoded[numbers] = True
            for at, network in enumerate(networks):
                if on_attention is None:
                    steering = network(as_input(crops))
                else:
                    steering, maps = predict_with_attention(network, as_input(crops))
                    on_attention(at, numbers, crops, maps.numpy())
                if not steering.isfinite().all():
                    raise RunError(f"{runs[at]}: its network predicts what is no number; train it again")
                predicted[at, numbers] = steering.numpy()
            advance(len(numbers))
            on_batch()
    return predicted, is_decoded


def as_input(pictures: NDArray[np.uint8]) -> torch.Tensor:
    """Pictures (N, 128, 128, 3) as the network's (N, 3, 128, 128), without a copy: this is channels_last."""
    return torch.from_numpy(pictures).permute(0, 3, 1, 2)
