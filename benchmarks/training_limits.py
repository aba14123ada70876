"""The cost of training on synthetic recordings: memory, seconds on a GPU, and each layer's share of a step.

python benchmarks/training_limits.py memory    # peak memory of bc-train, 1 epoch
python benchmarks/training_limits.py gpu       # 10 epochs of 7,650 pictures and their flips
python benchmarks/training_limits.py products  # each layer of a step, compared with matrix products of equal FLOPs

The pictures are noise, of the size of a simulator's: memory and speed do not depend on their content.
"""

from __future__ import annotations

import argparse
import copy
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

os.environ["THP_MEM_ALLOC_ENABLE"] = "1"  # as in bc-train, before PyTorch is imported

import torch
from torch import Tensor, nn

from common import UserError
from dataset import IndexConfig, build_index
from dataset.picture_spec import ORIGINAL
from model.adam import Adam
from model.config import Precision, TrainConfig
from model.device import choose_machine
from model.network.pilotnet import SteeringNetwork
from model.runs.training_progress import Epoch, Step
from model.training.step import training_step
from model.training.trainer import train
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState

PICTURES: Final = 7_650  # as many as the original project had
SMALL_BUDGET_MB: Final = 64
STEP_NS: Final = 100_000_000
ROUNDS: Final = 5
MATRIX: Final = 1 << 18  # numbers of a matrix that fits a core's cache


def made_up_index(folder: Path, pictures: int, config: IndexConfig) -> Path:
    """An index of one session with `pictures` different pictures, equally many of each of the config's cameras."""
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
    # only the centre camera, so that both indexes hold out a full batch
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
    """The peak memory of a bc-train process in MB."""
    bc_train = "from behavioural_cloning_toolkit import bc_train; bc_train()"
    command = [sys.executable, "-P", "-c", bc_train, "--epochs", "1", "--device", "cpu", *flags]
    process = subprocess.Popen([*command, "--index", str(index), "--runs", str(runs)], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"bc-train ended with code {process.returncode}")
    return usage.ru_maxrss / 1024


class Clock:
    """Stores the time at which each epoch ended."""

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
        print("PyTorch finds no GPU")
        return
    index = made_up_index(folder / "made_up", PICTURES, IndexConfig(balance=False, validation_share=0.0))
    print(f"{torch.cuda.get_device_name()}, PyTorch {torch.__version__}\n")
    print("| | all in all | once loaded | learning alone | samples/s |\n|---|---|---|---|---|")
    trainings: tuple[tuple[str, Precision], ...] = (
        ("bfloat16, the process' first training", "bfloat16"),
        ("bfloat16", "bfloat16"),
        ("float32 (TensorFloat-32)", "float32"),
    )
    for number, (name, precision) in enumerate(trainings):
        clock, start_s = Clock(), time.perf_counter()
        config = replace(TrainConfig.of("altered"), device="cuda", precision=precision)
        train(index, folder / str(number), config, [clock], show_progress=False)
        total_s = time.perf_counter() - start_s
        later_s = clock.done_s[-1] - clock.done_s[0]
        loaded_s = clock.epochs[0].seconds + later_s
        learning_s = sum(epoch.seconds for epoch in clock.epochs)
        rate = 2 * PICTURES * (len(clock.epochs) - 1) / later_s
        row = f"{name} | {total_s:.1f} s | {loaded_s:.1f} s | {learning_s:.1f} s | {rate:,.0f}"
        print(f"| {row} |", flush=True)


def print_products(_folder: Path) -> None:
    """Print the times of layers and matrix products: processor time of one thread, which other programs disturb
    least; in each round, all take turns."""
    config = replace(TrainConfig.of("altered"), device="cpu", threads=1)
    machine = choose_machine(config)
    network = SteeringNetwork(config.dropout, standardized=True).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    pictures = torch.randint(0, 256, (config.batch, 128, 128, 3), dtype=torch.uint8).permute(0, 3, 1, 2)
    optimizer, steering = Adam(network.parameters(), config.rate), torch.rand(config.batch) * 2 - 1
    layer_inputs: list[tuple[nn.Module, Tensor]] = []

    def add(layer: nn.Module, inputs: tuple[Tensor], outputs: Tensor) -> None:
        layer_inputs.append((layer, inputs[0].detach().to(machine.dtype)))

    hooks = [layer.register_forward_hook(add) for layer in network.modules() if hasattr(layer, "weight")]
    network.eval()(pictures[: machine.micro_batch])
    for hook in hooks:
        hook.remove()
    times = config.batch / machine.micro_batch
    parts = {
        str(layer): _layer_and_products(copy.deepcopy(layer).to(machine.dtype), inputs, times, number > 0)
        for number, (layer, inputs) in enumerate(layer_inputs)
    }
    network.train()

    def step() -> torch.Tensor:
        return training_step(
            network, optimizer, pictures, steering, dtype=machine.dtype, micro_batch=machine.micro_batch
        )

    parts["step"] = [(step, 1)]
    seconds: dict[str, list[list[float]]] = {name: [[] for _ in jobs] for name, jobs in parts.items()}
    for _round in range(ROUNDS):
        for name, jobs in parts.items():
            for (job, times), taken in zip(jobs, seconds[name], strict=True):
                job()
                begin_s = time.thread_time()
                job()
                taken.append(times * (time.thread_time() - begin_s))
    medians = {name: [statistics.median(taken) for taken in jobs_s] for name, jobs_s in seconds.items()}
    [step_s] = medians.pop("step")
    medians["all of them"] = [sum(column) for column in zip(*medians.values(), strict=True)]
    at_once = f"{machine.micro_batch} at once in {machine.arithmetic}"
    print(f"{config.batch} samples, {at_once}; shares of {step_s:.2f} s\n")
    print("| | forward | backward | products forward | products backward |\n|---|---|---|---|---|")
    for name, columns in medians.items():
        print(f"| {name} | {' | '.join(f'{share / step_s:.1%}' for share in columns)} |")
    products_s = sum(medians["all of them"][2:])
    rates = [f"{config.batch / taken:,.0f} samples/s" for taken in (products_s, step_s)]
    print(f"\npure matrix products of the same FLOPs: {rates[0]}; the step: {rates[1]}, {products_s / step_s:.0%}")


def _layer_and_products(
    layer: nn.Module, inputs: Tensor, times: float, has_gradient: bool
) -> list[tuple[Callable[[], object], float]]:
    """The forward and backward pass of a layer, and both as matrix products, each with its number of calls a
    batch."""
    weights = list(layer.parameters())
    inputs.requires_grad_(has_gradient)
    outputs: Tensor = layer(inputs)
    gradient, wanted = torch.randn_like(outputs), [*weights, *([inputs] if has_gradient else [])]
    matrix = torch.randn(weights[0].flatten(1).shape, dtype=inputs.dtype)
    rows = outputs.numel() // len(matrix)
    part = min(rows, MATRIX // matrix.shape[1])
    before, after = (torch.randn(part, columns, dtype=inputs.dtype) for columns in matrix.T.shape)

    def backward_products() -> None:
        after.T @ before
        if has_gradient:
            after @ matrix

    return [
        (lambda: layer(inputs), times),
        (lambda: torch.autograd.grad(outputs, wanted, gradient, retain_graph=True), times),
        (lambda: before @ matrix.T, times * rows / part),
        (backward_products, times * rows / part),
    ]


def main() -> None:
    contents = {"memory": print_memory, "gpu": print_gpu, "products": print_products}
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
