"""A training on a node of a Ray cluster. The command that has started it follows it in its run's files, because
all nodes share the disk."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from rich.progress import Progress

from common.progress import progress_bar
from common.ray_cluster import ClusterTasks, address_of, cluster_tasks
from model.config import TrainConfig
from model.errors import RunError
from model.network.names import is_own
from model.network.own_code import load_code
from model.runs.checkpoint import Position, read_position
from model.runs.history import read_history
from model.runs.provenance import training_of
from model.runs.run_folder import CONFIG, has_nothing_saved, load_config
from model.runs.training_progress import Epoch, Listener, Step
from model.training.loop import Listeners, step_note, training_title
from model.training.trainer import Trained, train


@contextlib.contextmanager
def cluster_trainer(ray: Sequence[str], config: TrainConfig) -> Iterator[Callable[..., Trained]]:
    """Connect to a cluster, and yield a function that trains on one of its nodes as `train` does here. `ray` is
    the value of --ray.

    The training has as many threads as it would have here, because rounding depends on them, and as many cores to
    itself; a GPU, too, if --device wants one. Raises ClusterError if no node has so many.
    """
    threads = config.threads or torch.get_num_threads()
    gpus = {"cpu": 0, "cuda": 1}.get(config.device)
    with cluster_tasks(address_of(ray), gpus, threads) as tasks:
        yield partial(_train, tasks, threads)


def _train(
    tasks: ClusterTasks,
    threads: int,
    index: Path,
    run: Path,
    config: TrainConfig,
    listeners: Sequence[Listener] = (),
    *,
    init: Path | None = None,
    like: Path | None = None,
    resume: bool = False,
) -> Trained:
    config = replace(config, threads=threads)
    notices: list[str] = []
    with contextlib.closing(Listeners(listeners, notices)) as guarded, progress_bar() as bar:
        follower = _Follower(run, guarded, bar, resume)
        try:
            call = index, run, config, init, like, resume
            trained = next(tasks(_train_on_node, [call], follower.follow))[1]
        finally:
            follower.follow()
    if trained is None:
        raise KeyboardInterrupt
    return replace(trained, notices=[*notices, *trained.notices])


def _train_on_node(
    index: Path, run: Path, config: TrainConfig, init: Path | None, like: Path | None, resume: bool
) -> Trained | None:
    """Train; None if the training was stopped. If a new run exists, its node has died, and it is resumed."""
    resume = resume or (run / CONFIG).exists()
    try:
        if resume and is_own(config.network):
            load_code(config.network)
        return train(index, run, config, init=init, like=like, resume=resume, show_progress=False)
    except KeyboardInterrupt:
        return None


class _Follower:
    """Shows the progress of a training on another machine."""

    def __init__(self, run: Path, listeners: Listeners, bar: Progress, resume: bool) -> None:
        self._run = run
        self._listeners = listeners
        self._bar = bar
        self._task = bar.add_task("waiting for a node", total=None, note="")
        self._epochs = 0  # to train; 0 until the training has begun
        self._config_before = self._config_version()
        is_continued = resume and not has_nothing_saved(run)
        position = read_position(run) if is_continued else Position()
        self._last = position.epoch, float(position.batch)  # all until then has been shown

    def follow(self) -> None:
        """Show what the run's files have more than at the last call."""
        with contextlib.suppress(RunError):
            if not self._has_begun():
                return
            history, _ = read_history(self._run)
            events: list[Step | Epoch] = [*history.steps, *history.epochs]
            for event in sorted(events, key=_place):
                if _place(event) > self._last:
                    self._last = _place(event)
                    self._show(event)

    def _has_begun(self) -> bool:
        """True once the training has written its settings, and removed what an earlier process had not saved."""
        if not self._epochs and self._config_version() != self._config_before:
            self._epochs = training_of(load_config(self._run), self._run).epochs
        return self._epochs > 0

    def _config_version(self) -> tuple[int, int] | None:
        try:
            with (self._run / CONFIG).open("rb") as stream:  # opened: a network's disk may keep an earlier `stat`
                stat = os.fstat(stream.fileno())
        except OSError:
            return None
        return stat.st_ino, stat.st_mtime_ns

    def _show(self, event: Step | Epoch) -> None:
        if isinstance(event, Epoch):
            self._listeners.epoch(event)
            return
        self._listeners.step(event)
        total, done = event.batches * self._epochs, event.batches * (event.epoch - 1) + event.batch
        title, note = training_title(event.epoch, self._epochs), step_note(event)
        if self._bar.tasks[0].total is None:  # a new task, so that the time left is not of the wait
            self._bar.remove_task(self._task)
            self._task = self._bar.add_task(title, total=total, completed=done, note=note)
        self._bar.update(self._task, description=title, completed=done, note=note)


def _place(event: Step | Epoch) -> tuple[int, float]:
    """Epoch and batch."""
    return event.epoch, event.batch if isinstance(event, Step) else math.inf
