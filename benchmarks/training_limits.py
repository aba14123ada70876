"""What a training costs on made-up recordings: memory, and seconds on a GPU.

python benchmarks/training_limits.py memory    # the most memory that bc-train takes, 1 epoch
python benchmarks/training_limits.py gpu       # 10 epochs over 7,650 pictures and their flips

The pictures are noise, as large as a simulator's; neither memory nor speed depends on what they show.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch

from common import UserError
from dataset import IndexConfig, build_index
from dataset.picture_spec import ORIGINAL
from model.config import TrainConfig
from model.runs.training_progress import Epoch, Step
from model.training.trainer import train
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState

PICTURES: Final = 7_650  # of the original project
SMALL_BUDGET_MB: Final = 64
STEP_NS: Final = 100_000_000


def made_up_index(folder: Path, pictures: int, config: IndexConfig) -> Path:
    """An index of one session of that many pictures, all different, as many of each of the config's cameras."""
    random = np.random.default_rng(0)
    folder.mkdir()
    with LogWriter(folder / "made_up.mcap", {"source": "benchmark"}) as writer:
        for row in range(pictures // len(config.cameras)):
            for camera in config.cameras:
                writer.picture(camera, row * STEP_NS, row, _noise(random))
            steering = float(np.clip(random.laplace(0.0, 0.15), -1, 1))
            writer.vehicle(row * STEP_NS, row, VehicleState(steering=steering))
    return build_index([folder / "made_up.mcap"], folder / "index", config).path


def _noise(random: np.random.Generator) -> bytes:
    """A JPEG of about 15 KB, 320 x 160."""
    coarse = random.integers(0, 256, (80, 160, 3)).astype(np.uint8)
    done, jpeg = cv2.imencode(".jpg", cv2.resize(coarse, (320, 160)), [cv2.IMWRITE_JPEG_QUALITY, 50])
    if not done:
        raise SystemExit("OpenCV writes no JPEG")
    return jpeg.tobytes()


def print_memory(folder: Path) -> None:
    # The centre camera's pictures only, so that both indexes have a full batch to validate on.
    plain = IndexConfig(balance=False, flip=False, cameras=("center",))
    budget = SMALL_BUDGET_MB * 2**20 // ORIGINAL.size_bytes
    small = ("--picture-memory-mb", str(SMALL_BUDGET_MB))
    print("| | most memory |\n|---|---|")
    for what, pictures, config, flags in (
        (f"{PICTURES:,} pictures, everything by default", PICTURES, IndexConfig(), ()),
        (f"`--picture-memory-mb {SMALL_BUDGET_MB}`, {budget:,} pictures: as many as fit", budget, plain, small),
        (f"`--picture-memory-mb {SMALL_BUDGET_MB}`, {10 * budget:,} pictures", 10 * budget, plain, small),
    ):
        place = folder / str(pictures)
        index = made_up_index(place, pictures, config)
        print(f"| {what} | {_most_memory_mb(index, place / 'runs', flags):,.0f} MB |", flush=True)


def _most_memory_mb(index: Path, runs: Path, flags: tuple[str, ...]) -> float:
    """Of the whole process of a bc-train."""
    command = [sys.executable, "-P", "-m", "model.train", "--epochs", "1", "--device", "cpu", *flags]
    process = subprocess.Popen([*command, "--index", str(index), "--runs", str(runs)], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"bc-train ended with code {process.returncode}")
    return usage.ru_maxrss / 1024


class Clock:
    """When each epoch was done: learnt, and its checkpoint written."""

    def __init__(self) -> None:
        self.done_s: list[float] = []
        self.epochs: list[Epoch] = []

    def step(self, step: Step) -> None:
        pass

    def epoch(self, epoch: Epoch) -> None:
        self.done_s.append(time.perf_counter())
        self.epochs.append(epoch)

    def close(self) -> None:
        pass


def print_gpu(folder: Path) -> None:
    if not torch.cuda.is_available():
        print("no GPU here")
        return
    index = made_up_index(folder / "made_up", PICTURES, IndexConfig(balance=False, validation_share=0.0))
    print(f"{torch.cuda.get_device_name()}, PyTorch {torch.__version__}\n")
    print("| | all in all | once loaded | learning alone | samples/s |\n|---|---|---|---|---|")
    for precision in ("bfloat16", "float32"):
        clock, start_s = Clock(), time.perf_counter()
        config = TrainConfig(device="cuda", precision=precision)
        train(index, folder / precision, config, [clock], show_progress=False)
        total_s = time.perf_counter() - start_s
        later_s = clock.done_s[-1] - clock.done_s[0]
        loaded_s = clock.epochs[0].seconds + later_s
        learning_s = sum(epoch.seconds for epoch in clock.epochs)
        rate = 2 * PICTURES * (len(clock.epochs) - 1) / later_s
        row = f"{precision} | {total_s:.1f} s | {loaded_s:.1f} s | {learning_s:.1f} s | {rate:,.0f}"
        print(f"| {row} |", flush=True)


def main() -> None:
    contents = {"memory": print_memory, "gpu": print_gpu}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=contents)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        try:
            contents[chosen.what](Path(name))
        except UserError as error:
            raise SystemExit(str(error)) from None


if __name__ == "__main__":
    main()
