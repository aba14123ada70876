"""The training loop: epochs of batches, what is measured after each, and what is saved so that nothing is lost."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from rich.progress import Progress
from torch import Tensor

from common import UserError
from common.errors import counted, printable
from common.versions import TOOLKIT
from dataset import Loader, Samples
from dataset.preprocess import CROP_BYTES
from dataset.samples.samples_reader import LOADED
from model.config import TrainConfig
from model.device import Machine
from model.errors import RunError
from model.evaluation.predict import predict
from model.metrics import measure
from model.network.original import SteeringNetwork
from model.progress_bar import progress_task
from model.runs.checkpoint import Position, checkpoint_path, load_checkpoint, save_checkpoint
from model.runs.run_arguments import run_argument
from model.runs.run_files import add_line, keep_lines
from model.runs.run_folder import WEIGHTS, load_config, load_network, save_weights
from model.runs.training_progress import METRICS_FILE, STEPS_FILE, Epoch, Listener, Step
from model.runs.worst_pictures import MOST_WORST_BYTES, WORST_COLUMNS, WORST_FILE, find_worst
from model.training.batches import make_batches
from model.training.busy_processor import busy_notice
from model.training.distributed import Group
from model.training.step import learn, make_optimizer

STEP_BATCHES: Final = 10
"""Batches between two lines of steps.jsonl."""
CHECKPOINT_S: Final = 60.0
"""What a kill costs at most; each checkpoint is 60 MB and takes a fraction of a second."""


class TrainingLoop:
    """A training in progress."""

    def __init__(
        self,
        samples: Samples,
        run: Path,
        config: TrainConfig,
        machine: Machine,
        group: Group,
        listeners: Sequence[Listener],
        bar: Progress,
    ) -> None:
        self.run = run
        self.config = config
        self.machine = machine
        self.group = group
        self.listeners = listeners
        self.bar = bar
        self.samples = samples
        self.history: list[Epoch] = []
        self.position = Position()
        budget_bytes = config.picture_memory_mb << 20
        loader = Loader(
            samples,
            samples.of_split("train", LOADED),
            batch=config.batch,
            seed=config.seed,
            rank=group.rank,
            ranks=group.ranks,
            budget_bytes=budget_bytes,
            threads=config.threads,
        )
        if not len(loader):
            raise RunError(
                f"{samples.path}: no training samples in it; record more, or give bc-index a smaller"
                " --validation-share or --gap-s"
            )
        with progress_task(bar, "reading pictures", loader.pictures) as advance:  # at once, where a GPU keeps them
            self.batches = make_batches(loader, machine.device, advance=advance)
        kept_bytes = loader.pictures * CROP_BYTES if machine.device.type == "cpu" else 0
        seen = samples.driving_view("validation")
        self._seen = seen.select(WORST_COLUMNS)
        self.validation = Loader(
            samples,
            seen,
            batch=machine.micro_batch,  # more at once would only take more memory
            budget_bytes=max(0, budget_bytes - kept_bytes),
            threads=config.threads,
        )
        self.skipped = [self.batches.skipped, self.validation.skipped]
        torch.manual_seed(config.seed)
        self.network = SteeringNetwork(config.dropout).to(machine.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimizer = make_optimizer(self.network, config.rate)
        self._best: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None  # predicted and recorded
        self._unsaved: tuple[int, dict[str, Tensor]] | None = None  # the best epoch's weights
        self._saved_s = time.monotonic()
        self.has_learnt = False
        """Whether anything that was learnt is saved."""
        self._is_busy_told = machine.device.type != "cpu"
        self.notices: list[str] = []
        self.remarks: list[str] = []

    def start_from(self, init: Path) -> None:
        """Take the weights of another run."""
        load_config(init)
        self.network.load_state_dict(load_network(init).state_dict())

    def begin(self) -> None:
        """Save what it begins with: from there a run that is killed early goes on."""
        self.group.first(lambda: save_checkpoint(self.run, self.network, self.optimizer, self.position))

    def go_back(self) -> None:
        """To where the run was stopped. Raises RunError if its checkpoint cannot be used."""
        path = checkpoint_path(self.run)
        self.position = load_checkpoint(self.run, self.network, self.optimizer)
        begun = self.position.epoch if self.position.batch else self.position.epoch - 1
        if self.config.epochs < begun:
            learnt = counted(begun, "epoch")
            raise RunError(f"{self.run}: has learnt from {learnt}, not {self.config.epochs:,}; give more --epochs")
        if self.position.batch > self.batches.batches:
            raise RunError(
                f"{path}: stands at batch {self.position.batch:,}, but an epoch has {self.batches.batches:,};"
                " train another run, perhaps from its weights: --init"
            )
        self.group.first(self.keep_history)
        if not self.group.is_first:  # the first one has the sums of all
            self.position = replace(
                self.position, squared_error=0.0, samples=0, told_squared_error=0.0, told_samples=0
            )

    def keep_history(self) -> None:
        """Leave of the run's files what was before its position."""
        seen = self._samples_seen()
        for name in (WORST_FILE, METRICS_FILE):
            keep_lines(self.run / name, lambda line: line["epoch"] < self.position.epoch)
        keep_lines(self.run / STEPS_FILE, lambda line: line["samples"] <= seen)

    @property
    def is_stopped_early(self) -> bool:
        """Whether there were more epochs, but no more patience."""
        patience, position = self.config.patience, self.position
        is_out_of_patience = position.best_epoch and position.epoch - 1 - position.best_epoch >= patience > 0
        return bool(is_out_of_patience and position.epoch <= self.config.epochs)

    def train(self, stopped: threading.Event) -> None:
        """All epochs that are left. Raises KeyboardInterrupt if `stopped`, with the run as it is then saved."""
        network = self.group.share(self.network)
        try:
            while not self.is_over:
                self._learn_epoch(network, stopped)
                self._end_epoch()
                if self.is_over or self.group.any(self._is_due())[0]:
                    self._save()
        finally:
            self._save_best()  # also if the epochs after it diverge

    def draw(self) -> None:
        """The run's pictures."""
        if not (self.run / WEIGHTS).exists():
            return
        if find_spec("matplotlib") is None:
            self.remarks.append(
                f'{self.run}: no pictures of how it went; `pip install "{TOOLKIT}[figures]"` brings them'
            )
            return
        try:
            from model.runs.run_figures import write_run_figures

            if self._best is None:
                self._best = predict(load_network(self.run), self.validation)
            write_run_figures(self.run, *self._best)
        except (UserError, OSError) as error:
            self.notices.append(str(error))

    def _learn_epoch(self, network: torch.nn.Module, stopped: threading.Event) -> None:
        start = self.position
        loader, group = self.batches, self.group
        network.train()
        error = torch.tensor(start.squared_error, dtype=torch.float64, device=self.machine.device)
        samples = start.samples
        begun_s = told_s = time.perf_counter()
        told_error, told_samples = start.told_squared_error, start.told_samples
        wall_s = cpu_s = 0.0  # of the steps since the last line
        name, note = f"epoch {start.epoch:,}/{self.config.epochs:,}", ""
        with progress_task(self.bar, name, len(loader) * self.config.epochs, self._samples_seen()) as advance:
            batches = loader.epoch(start.epoch, start.batch)
            for batch, (pictures, steering) in enumerate(batches, start.batch + 1):
                torch.manual_seed(_dropout_seed(self.config.seed, start.epoch, batch, group.rank))
                wall_s, cpu_s = wall_s - time.perf_counter(), cpu_s - time.thread_time()
                error += learn(
                    network,
                    self.optimizer,
                    pictures,
                    steering,
                    dtype=self.machine.dtype,
                    micro_batch=self.machine.micro_batch,
                    batch=min(self.config.batch, len(loader) - (batch - 1) * self.config.batch),
                    ranks=group.ranks,
                )
                wall_s, cpu_s = wall_s + time.perf_counter(), cpu_s + time.thread_time()
                samples += len(steering)
                self.position = replace(start, batch=batch)
                if batch % STEP_BATCHES == 0 or batch == loader.batches:
                    now_error = float(error)
                    loss, count = group.sum(now_error - told_error, samples - told_samples)
                    now_s = time.perf_counter()  # after what has waited for the GPU
                    if count:
                        note = self._tell(loss, int(count), now_s - told_s)
                    told_error, told_samples, told_s = now_error, samples, now_s
                    self._notice_if_busy(wall_s, cpu_s)
                    wall_s = cpu_s = 0.0
                advance(len(steering) * group.ranks, note)
                if group.ranks > 1 and batch % STEP_BATCHES and batch != loader.batches:
                    continue  # asking the other ranks makes a GPU wait
                is_stopped, is_due = group.any(stopped.is_set(), self._is_due())
                if is_stopped or is_due:
                    self._sum(float(error), samples, told_error, told_samples, begun_s)
                    self._save()
                    self.position = replace(self.position, seconds=start.seconds)
                if is_stopped:
                    raise KeyboardInterrupt
        self._sum(float(error), samples, told_error, told_samples, begun_s)

    def _notice_if_busy(self, wall_s: float, cpu_s: float) -> None:
        """Say so once, and at once: there may be hours to go."""
        if self._is_busy_told or not self.group.is_first:
            return
        if notice := busy_notice(torch.get_num_threads(), wall_s, cpu_s):
            logging.getLogger(__name__).warning("%s", printable(notice))
            self._is_busy_told = True

    def _end_epoch(self) -> None:
        if not self.position.samples:
            raise RunError(f"{self.samples.path}: none of its training pictures decodes; see `bc-index --look`")
        best_epoch, best_deg = self.group.sum(*(self.group.first(self._measure) or (0.0, 0.0)))
        self.position = Position(self.position.epoch + 1, best_epoch=int(best_epoch), best_deg=best_deg)

    def _measure(self) -> tuple[float, float]:
        """Measure the network after an epoch, and tell of it; the best epoch by now, and its balanced RMSE."""
        position = self.position
        with progress_task(self.bar, f"validation {position.epoch}", len(self.validation)) as advance:
            predicted, recorded = predict(self.network, self.validation, advance)
        if not np.isfinite(predicted).all() or not self._is_finite():
            raise self._diverged()
        measures = measure(predicted, recorded)
        balanced_deg = measures.balanced_rmse_deg
        is_best = balanced_deg < position.best_deg if len(recorded) else True
        epoch = Epoch(
            position.epoch,
            position.squared_error / position.samples,
            float(np.mean(np.square(predicted - recorded))) if len(recorded) else math.nan,
            measures,
            is_best,
            position.seconds,
            position.samples / position.seconds,
        )
        if len(recorded):  # before the epoch's own line: who reads that finds them
            worst = find_worst(position.epoch, self._seen, self.validation, predicted, recorded)
            self._make_room()
            add_line(self.run / WORST_FILE, worst.as_dict())
        add_line(self.run / METRICS_FILE, epoch.as_dict())
        self.history.append(epoch)
        if is_best:
            weights = {name: tensor.detach().cpu().clone() for name, tensor in self.network.state_dict().items()}
            self._unsaved = position.epoch, weights
            self._best = predicted, recorded
        for listener in self.listeners:
            listener.epoch(epoch)
        if is_best:
            return position.epoch, balanced_deg if len(recorded) else math.inf
        return position.best_epoch, position.best_deg

    def _make_room(self) -> None:
        """Once it is large, leave the later half of the worst frames' file."""
        path = self.run / WORST_FILE
        if path.exists() and path.stat().st_size > MOST_WORST_BYTES:
            begin = self.position.epoch - path.read_bytes().count(b"\n") // 2
            keep_lines(path, lambda line: line["epoch"] >= begin)

    def _tell(self, squared_error: float, samples: int, seconds: float) -> str:
        if not math.isfinite(squared_error):
            raise self._diverged()
        position = self.position
        loss, rate = squared_error / samples, samples / seconds
        if self.group.is_first:
            step = Step(position.epoch, position.batch, self.batches.batches, self._samples_seen(), loss, rate)
            add_line(self.run / STEPS_FILE, step.as_dict())
            for listener in self.listeners:
                listener.step(step)
        return f"loss {loss:.4f}  {rate:,.0f} samples/s"

    def _save(self) -> None:
        """Everything up to this moment. Weights that are no numbers are not saved."""
        if not self._is_finite():
            raise self._diverged()
        self.group.first(self._save_all)
        self._saved_s = time.monotonic()

    def _save_all(self) -> None:
        self._save_best()
        save_checkpoint(self.run, self.network, self.optimizer, self.position)
        self.has_learnt = True

    def _save_best(self) -> None:
        if self._unsaved is not None:
            epoch, weights = self._unsaved
            save_weights(self.run, weights, epoch)
            self._unsaved = None
            self.has_learnt = True

    def _sum(self, error: float, samples: int, told_error: float, told_samples: int, begun_s: float) -> None:
        """Bring the sums of all ranks, and the time since `begun_s`, into the position."""
        sums = self.group.sum(error, samples, told_error, told_samples)
        if not all(map(math.isfinite, sums)):
            raise self._diverged()
        self.position = replace(
            self.position,
            squared_error=sums[0],
            samples=int(sums[1]),
            told_squared_error=sums[2],
            told_samples=int(sums[3]),
            seconds=self.position.seconds + time.perf_counter() - begun_s,
        )

    def _is_due(self) -> bool:
        return time.monotonic() - self._saved_s > CHECKPOINT_S

    @property
    def is_over(self) -> bool:
        """Whether no epoch is left to learn."""
        return self.position.epoch > self.config.epochs or self.is_stopped_early

    def _samples_seen(self) -> int:
        """Since the run began."""
        position, epoch = self.position, len(self.batches)
        return (position.epoch - 1) * epoch + min(position.batch * self.config.batch, epoch)

    def _is_finite(self) -> bool:
        return all(bool(torch.isfinite(parameter).all()) for parameter in self.network.parameters())

    def _diverged(self) -> RunError:
        has_good = self._unsaved is not None or (self.run / WEIGHTS).exists()
        kept = (
            f"the best epoch before it is kept: `bc-train --init {run_argument(self.run)}`"
            if has_good
            else "train anew"
        )
        epoch, rate = self.position.epoch, self.config.rate
        return RunError(
            f"{self.run}: the loss is no longer finite in epoch {epoch}; {kept}"
            f" with a --rate smaller than {rate:g}"
        )


def _dropout_seed(seed: int, epoch: int, batch: int, rank: int) -> int:
    return int(np.random.SeedSequence((seed, epoch, batch, rank)).generate_state(1, np.uint64)[0])
