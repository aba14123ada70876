"""The training loop: epochs of batches, a validation after each epoch, and checkpoints."""

from __future__ import annotations

import copy
import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import torch
from msgspec.structs import replace
from rich.progress import Progress
from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn

from common import UserError
from common.errors import counted
from common.named_function import in_one_line
from common.progress import progress_task
from dataset import Loader, Samples
from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import steering_in
from model.adam import Adam
from model.config import TrainConfig
from model.device import Machine
from model.errors import RunError
from model.evaluation.predict import predict
from model.network.choice import NetworkChoice
from model.network.picture_network import PictureNetwork
from model.runs.answer_scale import AnswerScale
from model.runs.checkpoint import Position, checkpoint_path, load_checkpoint, save_checkpoint
from model.runs.run_files import run_argument
from model.runs.training_progress import Epoch, Listener, Step
from model.training.batches import make_batches
from model.training.run_writer import RunWriter
from model.training.step import TrainingSteps, least_samples
from model.training.validation import NaturalFrames, Validation

STEP_BATCHES: Final = 10
"""Batches between two lines of steps.jsonl."""
MAX_EPOCH_STEPS: Final = 10_000
"""Maximum lines of an epoch in steps.jsonl: in larger epochs, more batches are between two lines. Readers refuse a
file above 64 MiB, which two epochs of a billion samples would reach."""
CHECKPOINT_S: Final = 60.0
"""A kill loses no more than this time. A checkpoint is 60 MB and takes a fraction of a second."""


class TrainingLoop:
    def __init__(
        self,
        samples: Samples,
        writer: RunWriter,
        config: TrainConfig,
        network: NetworkChoice,
        picture: PictureSpec,
        machine: Machine,
        listeners: Listeners,
        bar: Progress,
    ) -> None:
        self.run = writer.run
        self.config = config
        self.machine = machine
        self.listeners = listeners
        self.bar = bar
        self.samples = samples
        self.writer = writer
        self.history: list[Epoch] = []
        self.position = Position()
        budget_bytes = config.picture_memory_mb << 20
        loader = self.loader = Loader(
            samples,
            samples.rows_of_split("train", config.targets),
            batch=config.batch,
            seed=config.seed,
            budget_bytes=budget_bytes,
            threads=config.threads,
            seen=picture,
            targets=config.targets,
            alter_each_epoch=config.epoch_alterations,
        )
        if not len(loader):
            raise RunError(
                f"{samples.path}: no training samples in it; index more sessions, or hold out none (`bc-index"
                " --validation-share 0`)"
            )
        with progress_task(bar, "reading pictures", loader.pictures) as advance:  # only if a GPU keeps them
            self.batches = make_batches(loader, machine.device, advance=advance)
        kept_bytes = loader.pictures * picture.size_bytes if machine.device.type == "cpu" else 0
        left_bytes = max(0, budget_bytes - kept_bytes)
        # a batch of more than `micro_batch` would only take more memory
        self.validation = Validation(samples, machine.micro_batch, left_bytes, config, picture)
        self.natural_frames = (
            NaturalFrames(
                samples,
                machine.micro_batch,
                config.threads,
                picture,
                keeps_pictures=machine.device.type != "cpu",  # on a GPU, decoding would take as long as an epoch
            )
            if config.answers == "natural"
            else None
        )
        self.answers = AnswerScale()  # of the last epoch
        self.skipped = [self.loader.skipped, self.validation.loader.skipped]
        torch.manual_seed(config.seed)
        self.network = network.build().to(machine.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.averaged = AveragedWeights(self.network, config.average_steps)
        self.optimizer = Adam(self.network.parameters(), config.rate)
        weights = torch.tensor(config.target_weights, device=machine.device) if config.target_weights else None
        height, width, channels = picture.shape
        blank = torch.zeros(1, channels, height, width, dtype=torch.uint8, device=machine.device)
        self.least = least_samples(self.network, blank)
        if self.least > min(config.batch, machine.micro_batch, len(loader)):
            raise RunError(
                f"the batch normalisation of this network needs {self.least} samples at once:"
                f" {counted(len(loader), 'training sample')}, --batch {config.batch}, --micro-batch"
                f" {machine.micro_batch}"
            )
        self.steps = TrainingSteps(
            self.network,
            self.optimizer,
            machine,
            config.batch,
            weights,
            least=self.least,
            can_record=network.code is None,
        )
        self._saved_s = time.monotonic()

    def begin(self) -> None:
        """Save the start of a new training, so that a run that is killed early can continue."""
        self.averaged.begin(self.network)
        save_checkpoint(self.run, self.network, self.averaged.network, self.optimizer, self.position)

    def resume(self) -> None:
        """Load the position at which the run was stopped. Raises RunError if the checkpoint cannot be used."""
        path = checkpoint_path(self.run)
        self.position = load_checkpoint(self.run, self.network, self.averaged.network, self.optimizer)
        begun = self.position.epoch if self.position.batch else self.position.epoch - 1
        if self.config.epochs < begun:
            learnt = counted(begun, "epoch")
            raise RunError(f"{self.run}: has learnt from {learnt}, not {self.config.epochs:,}; give more --epochs")
        if self.position.batch > self.loader.batches:
            raise RunError(
                f"{path}: is at batch {self.position.batch:,}, but an epoch has {self.loader.batches:,};"
                " train another run, perhaps from its weights: `bc-train continue RUN`"
            )
        position = self.position
        self.answers = AnswerScale(position.answer_scale, position.answer_offset, position.answer_curve)
        self.cut_history()

    def cut_history(self) -> None:
        """Remove all lines after the loop's position from the run's files."""
        self.writer.cut_history(self.position, self._samples_learnt())

    @property
    def is_stopped_early(self) -> bool:
        """True if epochs are left, but the patience is used up."""
        patience, position = self.config.patience, self.position
        is_out_of_patience = position.best_epoch and position.epoch - 1 - position.best_epoch >= patience > 0
        return bool(is_out_of_patience and position.epoch <= self.config.epochs)

    @property
    def is_over(self) -> bool:
        """True if no epoch is left to learn."""
        return self.position.epoch > self.config.epochs or self.is_stopped_early

    def train(self, stopped: threading.Event) -> None:
        """Train all remaining epochs. When `stopped` is set, save the run and raise KeyboardInterrupt."""
        try:
            while not self.is_over:
                self._train_epoch(stopped)
                self._end_epoch()
                if self.is_over or self._is_checkpoint_due():
                    self._save()
        finally:
            self.writer.save_best()  # also if a later epoch diverges

    def _train_epoch(self, stopped: threading.Event) -> None:
        start, loader = self.position, self.loader
        self.network.train()
        sums = _EpochSums(start, self.machine.device)
        interval = max(STEP_BATCHES, math.ceil(loader.batches / MAX_EPOCH_STEPS))
        begun_s = reported_s = time.perf_counter()
        name, note = training_title(start.epoch, self.config.epochs), ""
        total = len(loader) * self.config.epochs
        with progress_task(self.bar, name, total, self._samples_learnt()) as advance:
            batches = self.batches.epoch(start.epoch, start.batch)
            for batch, (pictures, labels) in enumerate(batches, start.batch + 1):
                if len(labels) >= self.least:  # else the sample is left out of this epoch
                    sums.add(self._train_batch(batch, pictures, labels), len(labels))
                self.position = replace(start, batch=batch)
                if batch % interval == 0 or batch == loader.batches:
                    loss, count = sums.take_unreported()
                    now_s = time.perf_counter()  # after `take_unreported`, which waits for the GPU
                    if count:
                        note = self._report(loss, count, now_s - reported_s)
                    reported_s = now_s
                advance(len(labels), note)
                is_stopped = stopped.is_set()
                if is_stopped or self._is_checkpoint_due():
                    self._take_sums(sums, begun_s)
                    self._save()
                    self.position = replace(self.position, seconds=start.seconds)
                if is_stopped:
                    raise KeyboardInterrupt
        self._take_sums(sums, begun_s)

    def _train_batch(self, batch: int, pictures: Tensor, labels: Tensor) -> Tensor:
        """Learn the batch with the number `batch`, from 1. Returns the sum of its squared errors."""
        config = self.config
        # the 0 gives the same seeds as earlier versions, for seeds of 2**32 and more
        entropy = np.random.SeedSequence((config.seed, self.position.epoch, batch, 0))
        torch.manual_seed(int(entropy.generate_state(1, np.uint64)[0]))
        samples = min(config.batch, len(self.loader) - (batch - 1) * config.batch)
        squared_error = self.steps.take(pictures, labels, samples)
        self.averaged.update(self.network, (self.position.epoch - 1) * self.loader.batches + batch)
        return squared_error

    def _report(self, squared_error: float, samples: int, seconds: float) -> str:
        """Write a step and pass it to the listeners. Returns the note for the progress bar."""
        if not math.isfinite(squared_error):
            raise self._diverged()
        position = self.position
        loss, rate = squared_error / samples, samples / seconds
        step = Step(position.epoch, position.batch, self.loader.batches, self._samples_learnt(), loss, rate)
        self.writer.add_step(step)
        self.listeners.step(step)
        return step_note(step)

    def _end_epoch(self) -> None:
        if not self.position.samples:
            raise RunError(f"{self.samples.path}: none of its training pictures decodes; see `bc-index --look`")
        best_epoch, best_error = self._validate()
        self.position = Position(
            self.position.epoch + 1,
            best_epoch=best_epoch,
            best_error=best_error,
            answer_scale=self.answers.scale,
            answer_offset=self.answers.offset,
            answer_curve=self.answers.curve,
        )

    def _validate(self) -> tuple[int, float]:
        """Measure the network after an epoch and report it. Returns the best epoch so far and its error."""
        position = self.position
        with progress_task(self.bar, f"validation {position.epoch}", len(self.validation)) as advance:
            learnt, recorded = predict(self.averaged.network, self.validation.loader, advance)
        if not np.isfinite(learnt).all() or not self._is_finite():
            raise self._diverged()
        if self.natural_frames is not None:
            self.answers = self.natural_frames.fit(self.averaged.network)
        predicted = learnt.copy()
        steering_in(predicted)[:] = self.answers.natural(steering_in(learnt))
        epoch = self.validation.epoch(position, learnt, predicted, recorded, self.answers)
        self.writer.add_epoch(epoch, self.validation.worst(position.epoch, predicted, recorded))
        self.history.append(epoch)
        if epoch.is_best:
            self.writer.keep_best(position.epoch, self.averaged.network, self.answers)
        self.listeners.epoch(epoch)
        if epoch.is_best:
            return position.epoch, self.validation.error(epoch.measures)
        return position.best_epoch, position.best_error

    def _take_sums(self, sums: _EpochSums, begun_s: float) -> None:
        """Store the sums of the epoch, and the time since `begun_s`, in the position."""
        squared_error = float(sums.squared_error)
        if not math.isfinite(squared_error):
            raise self._diverged()
        self.position = replace(
            self.position,
            squared_error=squared_error,
            samples=sums.samples,
            reported_squared_error=sums.reported_squared_error,
            reported_samples=sums.reported_samples,
            seconds=self.position.seconds + time.perf_counter() - begun_s,
        )

    def _save(self) -> None:
        """Save the checkpoint and the best weights. Raises RunError if the weights are not finite."""
        if not self._is_finite():
            raise self._diverged()
        self.writer.save(self.network, self.averaged.network, self.optimizer, self.position)
        self._saved_s = time.monotonic()

    def _is_checkpoint_due(self) -> bool:
        return time.monotonic() - self._saved_s > CHECKPOINT_S

    def _samples_learnt(self) -> int:
        """Samples learnt since the run began; repeated samples count again."""
        position, epoch = self.position, len(self.loader)
        return (position.epoch - 1) * epoch + min(position.batch * self.config.batch, epoch)

    def _is_finite(self) -> bool:
        return all(bool(torch.isfinite(parameter).all()) for parameter in self.network.parameters())

    def _diverged(self) -> RunError:
        kept = (
            f"the best earlier epoch is kept: `bc-train continue {run_argument(self.run)}`"
            if self.writer.has_best
            else "train again"
        )
        epoch, rate = self.position.epoch, self.config.rate
        return RunError(
            f"{self.run}: the loss is no longer finite in epoch {epoch}; {kept}"
            f" with a --rate smaller than {rate:g}"
        )


def training_title(epoch: int, epochs: int) -> str:
    """The text before the progress bar."""
    return f"training (epoch {epoch:,}/{epochs:,})"


def step_note(step: Step) -> str:
    """The text after the progress bar."""
    return f"loss {step.training_loss:.4f}  {step.samples_per_s:,.0f} samples/s"


class _EpochSums:
    """Sums over the learnt samples of an epoch, and their part that is in steps.jsonl."""

    def __init__(self, start: Position, device: torch.device) -> None:
        self.squared_error = torch.tensor(start.squared_error, dtype=torch.float64, device=device)
        self.samples = start.samples
        self.reported_squared_error = start.reported_squared_error
        self.reported_samples = start.reported_samples

    def add(self, squared_error: Tensor, samples: int) -> None:
        self.squared_error += squared_error
        self.samples += samples

    def take_unreported(self) -> tuple[float, int]:
        """The squared error and the number of the samples since the last call."""
        squared_error = float(self.squared_error)
        unreported = squared_error - self.reported_squared_error, self.samples - self.reported_samples
        self.reported_squared_error, self.reported_samples = squared_error, self.samples
        return unreported


_FIRST_STEPS: Final = 10
"""After N steps, the mean is over at most 1 + N / 10 of them, so that the random initial weights are soon
forgotten."""


class AveragedWeights:
    """A second network, whose weights are the exponential mean of the first one's over about `steps` steps.

    With one step, it is the first network itself.
    """

    def __init__(self, network: PictureNetwork, steps: int) -> None:
        self._steps = steps
        self.network = network if steps == 1 else copy.deepcopy(network)

    @torch.no_grad()
    def begin(self, network: PictureNetwork) -> None:
        """Begin with the weights of `network`, before its first step."""
        self.network.load_state_dict(network.state_dict())

    def update(self, network: PictureNetwork, steps_taken: int) -> None:
        """Add the weights of `network` to the mean. `steps_taken` counts from 1, after the first step."""
        if self.network is not network:
            keep = 1 - max(1 / self._steps, 1 / (1 + steps_taken / _FIRST_STEPS))
            update = get_ema_multi_avg_fn(keep)  # type: ignore[no-untyped-call]
            update(list(self.network.parameters()), list(network.parameters()), steps_taken)
            for mean, latest in zip(self.network.buffers(), network.buffers(), strict=True):
                mean.copy_(latest)  # buffers of a batch normalisation are already means


_LOGGER: Final = logging.getLogger(__name__)


class Listeners:
    def __init__(self, listeners: Sequence[Listener], notices: list[str]) -> None:
        """For each listener that fails, a line is added to `notices`."""
        self._listening = list(listeners)
        self._notices = notices

    def step(self, step: Step) -> None:
        self._call_each(lambda listener: listener.step(step))

    def epoch(self, epoch: Epoch) -> None:
        self._call_each(lambda listener: listener.epoch(epoch))

    def close(self) -> None:
        """Close all remaining listeners. Failed ones are already closed."""
        self._call_each(_close)

    def _call_each(self, method: Callable[[Listener], object]) -> None:
        for listener in list(self._listening):
            if error := _error_of(method, listener):
                self._listening.remove(listener)
                _error_of(_close, listener)  # it may still save data; a second error is ignored
                why = str(error) if isinstance(error, UserError) else in_one_line(error)
                line = f"{type(listener).__name__} receives nothing more of this training: {why}"
                self._notices.append(line)
                _LOGGER.warning("%s", line)


def _close(listener: Listener) -> object:
    return listener.close()


def _error_of(method: Callable[[Listener], object], listener: Listener) -> Exception | None:
    try:
        method(listener)
    except Exception as error:  # a user's own code
        return error
    return None
