"""A trained network that steers, one picture at a time."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from common.memory_allocator import keep_freed_memory
from dataset.preprocess import Image, preprocess
from model.config import Precision
from model.device import training_dtype
from model.evaluation.predict import as_input
from model.network.original import SteeringNetwork
from model.network.packing import pack_weights
from model.network.pooling import slice_max_pools
from model.runs.run_folder import load_config, load_network, run_name, weights_checksum

WARM_UP_PREDICTIONS = 20


class Pilot:
    """Predicts steering from what the car sees, on the processor. The same picture gives the same number."""

    def __init__(
        self, network: SteeringNetwork, run: str = "", weights_sha256: str = "", dtype: torch.dtype = torch.float32
    ) -> None:
        """Takes the network over: its weights are rounded to `dtype`, float32 or bfloat16, once and for all."""
        self.run = run
        self.weights_sha256 = weights_sha256
        self.arithmetic = str(dtype).removeprefix("torch.")
        """The arithmetic it calculates in: "float32" or "bfloat16"."""
        slice_max_pools(network.features)
        self._network = network.eval().to(dtype=dtype, memory_format=torch.channels_last)  # type: ignore[call-overload]
        if dtype == torch.bfloat16:
            pack_weights(network.features)
            pack_weights(network.head)
        # The network scales its input in float32.
        network.features.register_forward_pre_hook(lambda _, inputs: inputs[0].to(dtype))

    def crop(self, picture: Image) -> Image:
        """The crop that the network sees of a camera picture (height, width, 3) BGR: (128, 128, 3) BGR."""
        return preprocess(picture)

    @torch.inference_mode()
    def predict(self, crop: Image) -> float:
        """Steering for a crop (128, 128, 3) BGR uint8: -1 (left) .. 1 (right), not clamped; NaN or infinite if
        the weights are such."""
        return float(self._network(as_input(np.ascontiguousarray(crop)[None])).item())

    def warm_up(self) -> None:
        """Prepare this process for driving: the first predictions are slow, and should not fall into a drive.

        From here on it computes on one thread. On two, one picture is a fifth faster, but a busy machine makes
        every layer wait for the slower thread (one answer in a hundred then takes 20 ms), and the number of cores
        would show in the last bits of a steering.
        """
        keep_freed_memory()
        torch.set_num_threads(1)
        cv2.setNumThreads(1)
        for _ in range(WARM_UP_PREDICTIONS):
            self.predict(np.zeros((128, 128, 3), np.uint8))


def load_pilot(run: Path | str, precision: Precision = "auto") -> Pilot:
    """The pilot of a run folder.

    `precision` is what it calculates in; "auto" takes bfloat16 where the processor has it, as training does. One
    picture then takes five eighths of the time. Over 5,000 pictures, real and drawn, a trained network's steering
    differed by 0.02 degrees on average and by 0.2 at most from that of float32, in which evaluations measure.

    Raises RunError if the run is incomplete, damaged or of another version.
    """
    run = Path(run)
    load_config(run)
    return Pilot(
        load_network(run), run_name(run), weights_checksum(run), training_dtype(precision, torch.device("cpu"))
    )
