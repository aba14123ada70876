"""The PyTorch contenders of training.py, one epoch a turn.

python benchmarks/training_torch.py FOLDER train|step|plain < turns

FOLDER holds an index and the same pictures as JPEG files, as training.py writes them. For each line on stdin, it
trains an epoch and prints its seconds. The first epoch warms up.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import DataLoader, Dataset

from common.recipe import Recipe
from model.adam import Adam
from model.config import TrainConfig
from model.device import choose_machine
from model.network.pilotnet import PARAMETERS, SteeringNetwork
from model.runs.training_progress import Epoch, Step
from model.training.step import training_step
from model.training.trainer import train


def wait_for_turn() -> None:
    """Wait for a line on stdin. Ends the process at the end of stdin."""
    if not sys.stdin.readline():
        raise SystemExit


def take_turns(epoch: Callable[[], object]) -> None:
    while True:
        wait_for_turn()
        start_s = time.perf_counter()
        epoch()
        print(time.perf_counter() - start_s, flush=True)


class Turns:
    """A listener that waits for its turn between the epochs of a training."""

    def step(self, step: Step) -> None:
        pass

    def epoch(self, epoch: Epoch) -> None:
        print(epoch.seconds, flush=True)  # as in bc-train: without checkpoints
        wait_for_turn()

    def close(self) -> None:
        pass


def train_for_real(folder: Path, config: TrainConfig) -> None:
    """`bc-train` itself."""
    with tempfile.TemporaryDirectory() as name:
        wait_for_turn()
        train(folder / "index", Path(name) / "run", config, [Turns()], show_progress=False)


def step_alone(folder: Path, config: TrainConfig) -> None:
    """The same steps of the optimizer on equally many random pictures, which are in memory."""
    count = len(_samples(folder))
    machine = choose_machine(config)
    network = SteeringNetwork(config.dropout, standardized=True).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = Adam(network.parameters(), config.rate)
    pictures = torch.randint(0, 256, (count, 128, 128, 3), dtype=torch.uint8).permute(0, 3, 1, 2)
    steering = torch.rand(count) * 2 - 1
    batches = list(zip(torch.split(pictures, config.batch), torch.split(steering, config.batch), strict=True))
    network.train()

    def epoch() -> None:
        for batch, labels in batches:
            training_step(network, optimizer, batch, labels, dtype=machine.dtype, micro_batch=machine.micro_batch)

    take_turns(epoch)


class Files(Dataset[tuple[Tensor, Tensor]]):
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.samples = _samples(folder)

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, at: int) -> tuple[Tensor, Tensor]:
        name, flip, steering = self.samples[at]
        whole = cv2.imread(str(self.folder / name))
        assert whole is not None  # noqa: S101
        picture = cv2.resize(whole[50:-20], (128, 128))
        if flip == "1":
            picture = cv2.flip(picture, 1)
        channels_first = np.ascontiguousarray(picture.transpose(2, 0, 1), np.float32)
        return torch.from_numpy(channels_first) / 127.5 - 1, torch.tensor([float(steering)])


def plain_pytorch(folder: Path, config: TrainConfig) -> None:
    """A first, simple version: float32, channels first, a DataLoader with two workers."""
    choose_machine(config)  # sets the number of threads
    network = nn.Sequential(
        *(nn.Conv2d(3, 24, 5), nn.ReLU(), nn.MaxPool2d(2)),
        *(nn.Conv2d(24, 36, 5), nn.ReLU(), nn.MaxPool2d(2)),
        *(nn.Conv2d(36, 48, 5), nn.ReLU(), nn.MaxPool2d(2)),
        *(nn.Conv2d(48, 64, 3), nn.ReLU(), nn.Conv2d(64, 64, 3), nn.ReLU(), nn.Flatten()),
        *(nn.Dropout(0.5), nn.Linear(4096, 1164), nn.ReLU(), nn.Dropout(0.5), nn.Linear(1164, 100), nn.ReLU()),
        *(nn.Linear(100, 50), nn.ReLU(), nn.Linear(50, 10), nn.ReLU(), nn.Linear(10, 1)),
    )
    if sum(parameter.numel() for parameter in network.parameters()) != PARAMETERS:
        raise SystemExit("not the same network")
    optimizer = torch.optim.Adam(network.parameters(), lr=config.rate)
    loader = DataLoader(Files(folder), config.batch, shuffle=True, num_workers=2)

    def epoch() -> None:
        for pictures, steering in loader:
            optimizer.zero_grad()
            functional.mse_loss(network(pictures), steering).backward()  # type: ignore[no-untyped-call]
            optimizer.step()

    take_turns(epoch)


def _samples(folder: Path) -> list[list[str]]:
    """The file name, "1" if mirrored, and the steering of each sample."""
    with (folder / "samples.csv").open(newline="") as stream:
        return list(csv.reader(stream))


def main() -> None:
    contenders = {"train": train_for_real, "step": step_alone, "plain": plain_pytorch}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("contender", choices=contenders)
    parser.add_argument("--recipe", choices=get_args(Recipe), default="altered")
    parser.add_argument("--precision", choices=["auto", "float32", "bfloat16"], default="auto")
    parser.add_argument("--micro-batch", type=int, default=0)
    parser.add_argument("--picture-memory-mb", type=int, default=1024)
    parser.add_argument("--threads", type=int, default=0)
    chosen = parser.parse_args()
    config = replace(
        TrainConfig.of(chosen.recipe),
        epochs=1_000_000,
        device="cpu",
        precision=chosen.precision,
        micro_batch=chosen.micro_batch,
        picture_memory_mb=chosen.picture_memory_mb,
        threads=chosen.threads,
    )
    contenders[chosen.contender](chosen.folder, config)


if __name__ == "__main__":
    main()
