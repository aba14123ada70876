"""`bc-train`: a network learns to steer from the index."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from common import UserError
from common.command import DONE, FAILED, run_command, warn, warn_skipped
from common.errors import counted
from common.output import print_message, print_result
from common.streams import end_process
from model.config import TrainConfig

if TYPE_CHECKING:
    from model.progress import Epoch, Listener, Step


@dataclass(frozen=True)
class Train:
    """Train the network on the index; the run is kept in runs/NAME/.

    The index is built from all sessions if there is none yet. Ctrl-C stops after the current batch, and --resume
    goes on from there. `bc-train export RUN --onnx` gives a trained network to other programs.
    """

    name: str = ""
    """Name of the run; by default the date and time."""
    resume: str | None = None
    """Go on with this run where it was stopped or killed; more --epochs make it longer."""
    init: str | None = None
    """Start from the weights of this run, instead of random ones."""
    like: str | None = None
    """Repeat this run: its settings, and the index that it was trained on. Other flags change what they name."""
    tensorboard: bool = False
    """Write the curves for TensorBoard, too."""
    viewer: bool = False
    """Show the curves in the Rerun viewer while they grow."""
    index: Path = Path("index")
    """The index to train on."""
    sessions: Path = Path("sessions")
    """Where logs are kept, for an index that has to be built."""
    runs: Path = Path("runs")
    """Where runs are kept."""
    config: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)


def train(config: Train) -> int:
    from model.checkpoint import read_position
    from model.distributed import FirstRankError, local_rank_of_process, rank_of_process
    from model.machine import choose_machine
    from model.network import PARAMETERS
    from model.run import WEIGHTS, find_run
    from model.training import train as train_network

    is_first = rank_of_process() == 0
    run, index = _run_of(config), _index_of(config, is_first=is_first)
    init = find_run(config.init, config.runs) if config.init is not None else None
    settings = config.config
    machine = choose_machine(settings, local_rank_of_process())
    if is_first:
        where = "GPU" if machine.device.type == "cuda" else "processor"
        begin = read_position(run) if config.resume is not None else None
        going_on = f", going on in epoch {begin.epoch} after batch {begin.batch}" if begin is not None else ""
        epochs = counted(settings.epochs, "epoch")
        print_result(f"{run}: {PARAMETERS:,} parameters, {epochs}, {machine.arithmetic} on the {where}{going_on}")
    try:
        with _listeners(config, run, is_first=is_first) as listeners:
            is_resumed = config.resume is not None
            trained = train_network(index, run, settings, listeners, init=init, resume=is_resumed)
    except KeyboardInterrupt:
        if is_first and run.exists():
            command = "bc-train" if "WORLD_SIZE" not in os.environ else "torchrun ... --no-python bc-train"
            print_message(f"bc-train: what is learnt is kept; go on with `{command} --resume {run.name}`")
        raise
    except FirstRankError:
        return FAILED  # the first one says why
    code = max([DONE, *map(warn_skipped, trained.skipped)])
    if not is_first:
        return code
    code = max([code, *map(warn, trained.notices)])
    for remark in trained.remarks:
        print_message(remark)
    if trained.is_stopped_early:
        print_result(f"{run}: stopped early: {settings.patience} epochs were no better than the best (--patience)")
    elif not trained.epochs:
        print_result(f"{run}: all its epochs are learnt; give more --epochs to go on")
    best = trained.best_epoch
    print_result(f"{run / WEIGHTS}: the weights of epoch {best}; drive with `bc-drive {run.name}`")
    return code


class Printer:
    """Prints a line an epoch on stdout, and once what knowing nothing would give."""

    def __init__(self) -> None:
        self._has_begun = False

    def step(self, step: Step) -> None:
        """The bar shows it."""

    def epoch(self, epoch: Epoch) -> None:
        measures = epoch.measures
        if measures.frames and not self._has_begun:
            print_result(
                f"errors of {measures.frames:,} frames held out, in degrees; always the mean: RMSE"
                f" {measures.mean.rmse_deg:.2f}, always zero: {measures.zero.rmse_deg:.2f}"
            )
        self._has_begun = True
        validation = (
            f" RMSE {measures.network.rmse_deg:.2f}, balanced {measures.balanced_rmse_deg:.2f},"
            f" correlation {measures.network.correlation:.2f},"
            if measures.frames
            else " nothing held out,"
        )
        print_result(
            f"epoch {epoch.epoch:>2}: loss {epoch.training_loss:.4f},{validation}"
            f" {epoch.samples_per_s:,.0f} samples/s{', best' if epoch.is_best else ''}"
        )

    def close(self) -> None:
        """Nothing to close."""


@contextlib.contextmanager
def _listeners(config: Train, run: Path, *, is_first: bool) -> Iterator[list[Listener]]:
    listeners: list[Listener] = []
    with contextlib.ExitStack() as stack:
        if is_first:
            listeners.append(Printer())
            if config.tensorboard:
                from model.tensorboard import TensorBoard

                listeners.append(TensorBoard(run))
            if config.viewer:
                from common.preview import preview

                stack.enter_context(preview(run))
        yield listeners


def _run_of(config: Train) -> Path:
    if config.resume is not None:
        others = {"--name": config.name, "--init": config.init, "--like": config.like}
        if unfit := [flag for flag, value in others.items() if value]:
            raise UserError(f"{' and '.join(unfit)} make another run, --resume goes on with one: give one of them")
        from model.run import find_started

        return find_started(config.resume, config.runs)
    name = config.name or datetime.now().astimezone().strftime("%Y-%m-%d_%H-%M-%S")
    if Path(name).name != name or name.startswith("."):
        raise UserError(f"--name {name!r}: a plain name was expected; give the folder with --runs")
    if (config.runs / name).exists():
        raise UserError(
            f"{config.runs / name}: exists already; give another --name, or go on with it: --resume {name}"
        )
    return config.runs / name


def _index_of(config: Train, *, is_first: bool) -> Path:
    """The index to train on, built if need be; what it does not hold is told."""
    from dataset import build_index, find_logs, sessions_not_indexed
    from dataset.samples_format import SAMPLES_NAME

    if config.like is not None:
        from model.like import index_of_run
        from model.run import find_started

        return index_of_run(find_started(config.like, config.runs), config.index, config.sessions)
    if not (config.index / SAMPLES_NAME).exists():
        if "WORLD_SIZE" in os.environ:
            raise UserError(f"{config.index}: no index yet; build it with `bc-index` before torchrun")
        print_message(f"{config.index}: no index yet; building it from {config.sessions}")
        build_index(find_logs((), config.sessions), config.index)
    elif is_first and (absent := sessions_not_indexed(config.index, config.sessions)):
        print_message(
            f"{config.index}: does not hold {', '.join(absent)}; `bc-index` takes in all of {config.sessions}"
        )
    return config.index


def _defaults() -> Train:
    """What holds where no flag is given: the settings of the run that is named with --resume or --like."""
    given = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    given.add_argument("--resume")
    given.add_argument("--like")
    given.add_argument("--runs", type=Path, default=Train.runs)
    with contextlib.suppress(argparse.ArgumentError):  # tyro says what is wrong
        flags, _ = given.parse_known_args()
        if name := flags.resume if flags.resume is not None else flags.like:
            from model.like import init_of_run
            from model.provenance import training_of
            from model.run import CONFIG, find_started, load_config

            run = find_started(name, flags.runs)
            settings = training_of(load_config(run), str(run / CONFIG))
            init = init_of_run(run, flags.runs) if flags.resume is None else None
            return Train(config=settings, init=str(init) if init is not None else None)
    return Train()


def main() -> None:
    if sys.argv[1:2] == ["export"]:
        from model.export_cli import main as export

        export()
    try:
        run_command("bc-train", Train, train, default=_defaults)
    except SystemExit as ended:
        if "WORLD_SIZE" not in os.environ:
            raise
        # A thread of torchrun's process group that came back while Python ended was seen to abort the process.
        end_process(ended.code if isinstance(ended.code, int) else int(ended.code is not None))
