"""Writes a run folder during the training: history, best weights and checkpoints."""

from __future__ import annotations

import itertools
from dataclasses import asdict
from pathlib import Path

from torch import Tensor, nn

from model.adam import Adam
from model.network.picture_network import PictureNetwork
from model.runs.answer_scale import AnswerScale
from model.runs.checkpoint import Position, save_checkpoint
from model.runs.run_files import append_json_line, keep_json_lines
from model.runs.run_folder import WEIGHTS, save_weights
from model.runs.training_progress import MAX_HISTORY_BYTES, METRICS_FILE, STEPS_FILE, Epoch, Step
from model.runs.worst_pictures import MAX_WORST_BYTES, WORST_FILE, WorstPictures


class RunWriter:
    def __init__(self, run: Path) -> None:
        self.run = run
        self.has_saved = False
        """True once learnt weights are saved."""
        self._best_epoch = 0
        self._unsaved_best: tuple[int, dict[str, Tensor], AnswerScale] | None = None

    def cut_history(self, position: Position, samples: int) -> None:
        """Remove all lines after `position` from the run's files; `samples` is the number of samples learnt by
        then."""
        self._best_epoch = position.best_epoch
        for name in (WORST_FILE, METRICS_FILE):
            keep_json_lines(self.run / name, lambda line: line["epoch"] < position.epoch)
        keep_json_lines(self.run / STEPS_FILE, lambda line: line["samples"] <= samples)

    def add_step(self, step: Step) -> None:
        self._thin(self.run / STEPS_FILE)
        append_json_line(self.run / STEPS_FILE, asdict(step))

    def add_epoch(self, epoch: Epoch, worst: WorstPictures | None) -> None:
        if worst is not None:  # before the line of the epoch: readers that find it expect the pictures, too
            self._trim_worst(worst.epoch)
            append_json_line(self.run / WORST_FILE, worst.as_dict())
        self._thin(self.run / METRICS_FILE)
        append_json_line(self.run / METRICS_FILE, epoch.as_dict())
        if epoch.is_best:
            self._best_epoch = epoch.epoch

    def keep_best(self, epoch: int, network: PictureNetwork, answers: AnswerScale) -> None:
        """Copy the network's weights, with their answer scale, to save them later as those of the best epoch."""
        weights = {name: tensor.detach().to("cpu", copy=True) for name, tensor in network.state_dict().items()}
        self._unsaved_best = epoch, weights, answers

    @property
    def has_best(self) -> bool:
        """True if there are weights of a finished epoch, saved or not."""
        return self._unsaved_best is not None or (self.run / WEIGHTS).exists()

    def save(self, network: nn.Module, averaged: nn.Module, optimizer: Adam, position: Position) -> None:
        self.save_best()
        save_checkpoint(self.run, network, averaged, optimizer, position)
        self.has_saved = True

    def save_best(self) -> None:
        if self._unsaved_best is not None:
            epoch, weights, answers = self._unsaved_best
            save_weights(self.run, weights, epoch, answers)
            self._unsaved_best = None
            self.has_saved = True

    def _thin(self, path: Path) -> None:
        """If a file is large, keep only every second line, and the errors of the best epoch."""
        if path.exists() and path.stat().st_size > MAX_HISTORY_BYTES:
            is_second = itertools.cycle([False, True])
            keep_json_lines(
                path, lambda line: next(is_second) or ("is_best" in line and line["epoch"] == self._best_epoch)
            )

    def _trim_worst(self, epoch: int) -> None:
        """If worst.jsonl is large, keep only the later half of its epochs."""
        path = self.run / WORST_FILE
        if path.exists() and path.stat().st_size > MAX_WORST_BYTES:
            first = epoch - path.read_bytes().count(b"\n") // 2
            keep_json_lines(path, lambda line: line["epoch"] >= first)
