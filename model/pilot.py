"""A trained network that steers, one picture at a time."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from dataset.preprocess import Image, preprocess
from model.network import SteeringNetwork
from model.predict import as_input
from model.run import checksum, load_config, load_network, run_name


class Pilot:
    """Predicts steering from what the car sees. The same picture always gives the same number."""

    def __init__(self, network: SteeringNetwork, run: str = "", weights_sha256: str = "") -> None:
        self.run = run
        self.weights_sha256 = weights_sha256
        self._network = network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def crop(self, picture: Image) -> Image:
        """What the network sees of a camera picture (height, width, 3) BGR: (128, 128, 3) BGR."""
        return preprocess(picture)

    @torch.inference_mode()
    def predict(self, crop: Image) -> float:
        """Steering for a crop (128, 128, 3) BGR uint8: -1 (left) .. 1 (right), not clamped."""
        return float(self._network(as_input(np.ascontiguousarray(crop)[None])).item())

    def get_ready(self) -> None:
        """Prepare this process for driving: the first predictions are slow, and should not fall into a drive.

        From here on it computes on one thread. On more, one picture is hardly faster, a busy machine makes
        every layer wait for the slowest thread, and the number of cores would show in the last bits of a steering.
        """
        torch.set_num_threads(1)
        cv2.setNumThreads(1)
        for _ in range(5):
            self.predict(np.zeros((128, 128, 3), np.uint8))


def load_pilot(run: Path) -> Pilot:
    """The pilot of a run folder. Raises RunError if the run is incomplete, damaged or of another version."""
    load_config(run)
    return Pilot(load_network(run), run_name(run), checksum(run))
