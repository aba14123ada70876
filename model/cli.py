"""`bc-train`: a network learns to steer from the index."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from common.command import DONE, run_command, stderr
from model.config import TrainConfig

if TYPE_CHECKING:
    from model.training import Epoch


@dataclass(frozen=True)
class Train:
    """Train the network on the index; the run is kept in runs/NAME/.

    The index is built from all sessions if there is none yet.
    """

    name: str = ""
    """Name of the run; by default the date and time."""
    index: Path = Path("index")
    """The index to train on."""
    sessions: Path = Path("sessions")
    """Where logs are kept, for an index that has to be built."""
    runs: Path = Path("runs")
    """Where runs are kept."""
    config: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)


def train(config: Train) -> int:
    from dataset import build_index, find_logs, sessions_not_indexed
    from dataset.index import SAMPLES_NAME
    from model.network import PARAMETERS
    from model.run import WEIGHTS
    from model.training import train as train_network

    if not (config.index / SAMPLES_NAME).exists():
        stderr().print(f"{config.index}: no index yet; building it from {config.sessions}")
        build_index(find_logs((), config.sessions), config.index)
    elif absent := sessions_not_indexed(config.index, config.sessions):
        stderr().print(
            f"{config.index}: does not hold {', '.join(absent)}; `bc-index` takes in all of {config.sessions}"
        )
    run = config.runs / (config.name or datetime.now().astimezone().strftime("%Y-%m-%d_%H-%M-%S"))
    print(f"{run}: {PARAMETERS:,} parameters, {config.config.epochs} epochs", flush=True)
    train_network(config.index, run, config.config, report_epoch)
    print(f"{run / WEIGHTS}: trained; drive with `bc-drive {run.name}`")
    return DONE


def report_epoch(epoch: Epoch) -> None:
    validation, mean, zero = epoch.validation, epoch.mean, epoch.zero
    print(
        f"epoch {epoch.epoch:>2}: training loss {epoch.training_loss:.4f},"
        f" validation RMSE {validation.rmse_deg:.2f} deg"
        f" (always the mean {mean.rmse_deg:.2f}, always zero {zero.rmse_deg:.2f}),"
        f" correlation {validation.correlation:.2f}, {epoch.samples_per_s:,.0f} samples/s",
        flush=True,
    )


def main() -> None:
    run_command("bc-train", Train, train)
