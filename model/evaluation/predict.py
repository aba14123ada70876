"""Predictions of networks for pictures: the same code for training, evaluation and driving."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from common.process_settings import keep_freed_memory
from common.progress import progress_bar, progress_task
from dataset import Loader
from dataset.picture_spec import PictureSpec
from dataset.preprocessing import Image, as_bgr
from model.errors import RunError
from model.network.picture_network import PictureNetwork
from model.network.visual_backprop import visual_backprop
from model.runs.run_folder import load_network, picture_of_run

BATCH: Final = 64  # fits a processor's cache

AttentionCallback = Callable[[int, NDArray[np.int64], Image, NDArray[np.float32]], object]
"""Called with the number of the run (0, 1 ...), the numbers of pictures (N,), their crops (N, height, width, 3)
BGR, and their attention maps (N, height, width), 0..1."""

BatchesOf = Callable[[PictureSpec], Iterable[tuple[NDArray[np.int64], Image]]]
"""Yields batches of pictures as a network sees them: their numbers and their crops."""


@torch.inference_mode()
def predict(
    network: PictureNetwork, loader: Loader, advance: Callable[[int], object] = lambda samples: None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The network's answers and the recorded values, steering (N,) or targets (N, K), for a loader's samples in
    order. Arithmetic is float32 on the network's device. `advance` is called with the number of samples done since
    the last call."""
    network.eval()
    device = next(network.parameters()).device
    predicted, recorded = [np.zeros((0, *answer_shape(network)))], [np.zeros((0, *loader.rows.label.shape[1:]))]
    for batch in loader.in_order():
        predicted.append(network(as_input(batch.pictures).to(device)).cpu().numpy().astype(np.float64))
        recorded.append(batch.labels.astype(np.float64))
        advance(len(batch.labels))
    return np.concatenate(predicted), np.concatenate(recorded)


@torch.inference_mode()
def predict_crops(
    runs: Sequence[Path],
    batches: BatchesOf,
    count: int,
    on_attention: AttentionCallback | None = None,
    on_batch: Callable[[], object] = lambda: None,
) -> tuple[list[NDArray[np.float64]], NDArray[np.bool_]]:
    """The answers of each run's network for `count` pictures, steering (count,) or targets (count, K), and which
    pictures had a crop (count,). Shows a progress bar. Networks that see the same picture share its decoding.
    `on_batch` is called after each batch, and may raise an exception to stop.

    Raises RunError if a run is incomplete or damaged, or if its network answers a number that is not finite.
    """
    pictures = [picture_of_run(run) for run in runs]
    networks = [load_network(run).to(memory_format=torch.channels_last) for run in runs]  # type: ignore[call-overload]
    keep_freed_memory()
    predicted = [np.zeros((count, *answer_shape(network))) for network in networks]
    is_decoded = np.zeros(count, np.bool_)
    different = list(dict.fromkeys(pictures))
    with progress_bar() as bar, progress_task(bar, "frames", count * len(different)) as advance:
        for picture in different:
            seeing = [at for at, spec in enumerate(pictures) if spec == picture]
            for numbers, crops in batches(picture):
                is_decoded[numbers] = True
                for at in seeing:
                    try:
                        if on_attention is None:
                            answers = networks[at](as_input(crops))
                        else:
                            answers, maps = visual_backprop(networks[at], as_input(crops))
                            shown = np.stack([as_bgr(crop, picture) for crop in crops]) if len(crops) else crops
                            on_attention(at, numbers, shown, maps.numpy())
                    except RunError as error:
                        raise RunError(f"{runs[at]}: {error}") from None
                    if not answers.isfinite().all():
                        raise RunError(
                            f"{runs[at]}: its network predicts a number that is not finite; train it again"
                        )
                    predicted[at][numbers] = answers.numpy()
                advance(len(numbers))
                on_batch()
    return predicted, is_decoded


def answer_shape(network: PictureNetwork) -> tuple[int, ...]:
    return () if network.outputs == 1 else (network.outputs,)


def as_input(pictures: NDArray[np.uint8]) -> torch.Tensor:
    """Pictures (N, height, width, 3) as the network's input (N, 3, height, width), channels_last, without a
    copy."""
    return torch.from_numpy(pictures).permute(0, 3, 1, 2)
