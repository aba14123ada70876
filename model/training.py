"""Training: mean squared error, Adam, on the balanced index.

bc-train --epochs 10
"""

from __future__ import annotations

import hashlib
import json
import math
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from rich.progress import Progress, TaskID
from torch.nn import functional

from common.progress import progress_bar
from dataset import Batch, Loader, Samples
from dataset.samples_file import LOADED
from model.config import Precision, TrainConfig
from model.errors import RunError
from model.measures import Errors, constant_errors, errors
from model.network import PARAMETERS, SteeringNetwork
from model.run import add_metrics, create_run, kept_if_trained, save_weights

# The gradient of a batch is summed over parts of this size, which stay in the processor's cache: measured 410-480
# samples/s against 370 for the whole batch at once.
MICRO_BATCH: Final = 64


@dataclass(frozen=True)
class Epoch:
    """How one epoch went."""

    epoch: int  # from 1
    training_loss: float  # mean squared error over the epoch's samples, while they were learnt
    validation: Errors  # of the driving view: centre camera, unmirrored, unaltered
    zero: Errors  # of always predicting 0 on the same pictures
    mean: Errors  # of always predicting those pictures' own mean: no constant does better
    seconds: float
    samples_per_s: float


def train(
    index: Path, run: Path, config: TrainConfig | None = None, report: Callable[[Epoch], None] | None = None
) -> list[Epoch]:
    """Train a new network on `index` and keep it in the new folder `run`; `report` is told of every epoch.

    Raises DatasetError if the index does not fit its logs, RunError if the run exists or diverges.
    """
    config = config or TrainConfig()
    samples = Samples(index)
    try:
        return _train(samples, run, config, report)
    finally:
        samples.close()


def _train(
    samples: Samples, run: Path, config: TrainConfig, report: Callable[[Epoch], None] | None
) -> list[Epoch]:
    if config.threads:
        torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    dtype = training_dtype(config.precision)
    budget = config.picture_memory_mb << 20
    training = Loader(
        samples, samples.of_split("train", LOADED), batch=config.batch, seed=config.seed, budget_bytes=budget
    )
    seen = samples.driving_view("validation")
    validation = Loader(samples, seen, batch=config.batch, budget_bytes=budget)
    if not len(training):
        raise RunError(
            f"{samples.path}: no training samples in it; record more, or give bc-index a smaller"
            " --validation-share or --gap-s"
        )
    recorded = seen["label"].to_numpy()
    mean = float(np.mean(recorded)) if len(recorded) else float("nan")

    network = SteeringNetwork(config.dropout).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    assert sum(p.numel() for p in network.parameters()) == PARAMETERS  # noqa: S101
    optimizer = torch.optim.Adam(network.parameters(), lr=config.rate)
    create_run(run, _provenance(samples, config, dtype))

    history: list[Epoch] = []
    with kept_if_trained(run), progress_bar() as progress:
        for number in range(1, config.epochs + 1):
            task = progress.add_task(f"epoch {number}/{config.epochs}", total=len(training), note="")
            start_s = time.perf_counter()
            loss = _one_epoch(network, optimizer, training.epoch(number), dtype, progress, task)
            seconds = time.perf_counter() - start_s
            if not math.isfinite(loss):
                raise RunError(f"{run}: the loss is no longer finite in epoch {number}; try a smaller --rate")
            save_weights(run, network)
            epoch = Epoch(
                number,
                loss,
                errors(predict(network, validation), recorded),
                constant_errors(0.0, recorded),
                constant_errors(mean, recorded),
                seconds,
                len(training) / seconds,
            )
            add_metrics(run, asdict(epoch))
            history.append(epoch)
            progress.remove_task(task)
            if report:
                report(epoch)
    return history


def _one_epoch(
    network: SteeringNetwork,
    optimizer: torch.optim.Optimizer,
    batches: Iterator[Batch],
    dtype: torch.dtype,
    progress: Progress,
    task: TaskID,
) -> float:
    """Learn from every batch once; the mean loss over the samples."""
    network.train()
    squared_error, count = 0.0, 0
    start_s = time.perf_counter()
    for batch in batches:
        optimizer.zero_grad(set_to_none=True)
        for part in range(0, len(batch.steering), MICRO_BATCH):
            pictures = as_input(batch.pictures[part : part + MICRO_BATCH])
            steering = torch.from_numpy(batch.steering[part : part + MICRO_BATCH])
            with torch.autocast("cpu", dtype=dtype, enabled=dtype != torch.float32):
                predicted = network(pictures)
            loss = functional.mse_loss(predicted.float(), steering, reduction="sum")
            (loss / len(batch.steering)).backward()  # type: ignore[no-untyped-call]
            squared_error += loss.item()
        optimizer.step()
        count += len(batch.steering)
        note = f"loss {squared_error / count:.4f}  {count / (time.perf_counter() - start_s):,.0f} samples/s"
        progress.update(task, advance=len(batch.steering), note=note)
    return squared_error / count


@torch.inference_mode()
def predict(network: SteeringNetwork, loader: Loader) -> NDArray[np.float64]:
    """The network's steering (N,) for all of a loader's samples, in their order; float32 arithmetic."""
    network.eval()
    parts = [network(as_input(batch.pictures)).numpy() for batch in loader.in_order()]
    return np.concatenate([*parts, np.zeros(0, np.float32)]).astype(np.float64)


def as_input(pictures: NDArray[np.uint8]) -> torch.Tensor:
    """Pictures (N, 128, 128, 3) as the network's (N, 3, 128, 128), without a copy: this is channels_last."""
    return torch.from_numpy(pictures).permute(0, 3, 1, 2)


def training_dtype(precision: Precision) -> torch.dtype:
    """The arithmetic to train in on this machine."""
    if precision != "auto":
        return torch.bfloat16 if precision == "bfloat16" else torch.float32
    capabilities = torch.cpu.get_capabilities()
    has_bfloat16 = capabilities.get("avx512_bf16") or capabilities.get("amx_bf16") or capabilities.get("bf16")
    return torch.bfloat16 if has_bfloat16 else torch.float32


def _provenance(samples: Samples, config: TrainConfig, dtype: torch.dtype) -> dict[str, Any]:
    """Where a run comes from: its settings, the exact log bytes it saw, and the versions that trained it."""
    data = json.dumps(samples.metadata, sort_keys=True).encode()
    return {
        "network": "bojarski2016-modified",
        "parameters": PARAMETERS,
        "training": {**config.as_dict(), "arithmetic": str(dtype).removeprefix("torch.")},
        "data": {"fingerprint": hashlib.sha256(data).hexdigest(), **samples.metadata},
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("behavioural-cloning-toolkit", "torch", "numpy", "pyarrow")},
            "opencv": version("opencv-python-headless"),
        },
    }
