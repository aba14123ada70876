"""How a training goes, read from its run folder, also while it goes on.

metrics.jsonl   one line of JSON an epoch
steps.jsonl     one line of JSON every few batches
worst.jsonl     one line of JSON an epoch

A run may come from somebody else: a line that says what cannot be is left out and named.
"""

from __future__ import annotations

import base64
import json
import math
import stat
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from common import Skipped
from common.file_tail import FileTail
from dataset.preprocess import decode, is_crop
from model.errors import RunError
from model.metrics import BinErrors, Errors, Measures
from model.runs.training_progress import METRICS_FILE, STEPS_FILE, Epoch, Step
from model.runs.worst_pictures import WORST_COUNT, WORST_FILE, WorstPictures
from model.worst_moments import WorstFrame

_MOST_BYTES: Final = 64 << 20  # of a file: half a million steps
_MOST_LINE_BYTES: Final = 1 << 20
_MOST: Final = 1 << 62  # samples, or ns; beyond it, nothing was ever trained
_MOST_CHARACTERS: Final = 1000
_LARGEST: Final = 1e100  # its square is still a number


@dataclass(frozen=True)
class History:
    """What a run's folder tells of its training, in the order in which it happened."""

    epochs: tuple[Epoch, ...]
    steps: tuple[Step, ...]
    worst: tuple[WorstPictures, ...] = ()

    @property
    def best(self) -> Epoch | None:
        return next((epoch for epoch in reversed(self.epochs) if epoch.is_best), None)


def read_history(run: Path) -> tuple[History, Skipped]:
    """All that is told of a training by now, and the lines that had to be left out.

    Raises RunError if the folder holds no training, or a file of it is a link, too large or cannot be read.
    """
    reader = HistoryReader(run)
    history, _ = reader.read()
    if not any((run / name).exists() for name in (METRICS_FILE, STEPS_FILE)):
        raise RunError(f"{run}: no training in it ({METRICS_FILE} is missing); `bc-train` makes a run")
    reader.name_unfinished()
    return history, reader.skipped


class HistoryReader:
    """Reads a run's files as they grow; `skipped` holds the lines that say what cannot be."""

    def __init__(self, run: Path) -> None:
        self._run = run
        self._begin()

    def _begin(self) -> None:
        self.skipped = Skipped()
        self._metrics, self._steps, self._worst = (
            FileTail(self._run / name, _MOST_LINE_BYTES) for name in (METRICS_FILE, STEPS_FILE, WORST_FILE)
        )
        self._last_epoch, self._last_samples, self._last_worst = 0, 0, 0

    def read(self) -> tuple[History, bool]:
        """What was added since the last call; and whether the files were replaced, as when a training is resumed:
        then all is read anew. Raises RunError as `read_history` does, and if the folder is gone."""
        if not self._run.is_dir():
            raise RunError(f"{self._run}: no such run folder, or no more: a training that is stopped early goes")
        found = self._read_files()
        is_replaced = any(lines is None for lines in found)
        if is_replaced:
            self._begin()
            found = self._read_files()
        metrics, steps, worst = (lines or [] for lines in found)
        history = History(
            tuple(self._parsed(METRICS_FILE, metrics, self._next_epoch)),
            tuple(self._parsed(STEPS_FILE, steps, self._next_step)),
            tuple(self._parsed(WORST_FILE, worst, self._next_worst)),
        )
        return history, is_replaced

    def _read_files(self) -> list[list[tuple[int, bytes]] | None]:
        """Metrics first: the steps and the worst frames of every epoch that is read are then there too."""
        return [_new_lines(file) for file in (self._metrics, self._steps, self._worst)]

    def name_unfinished(self) -> None:
        """Count a last line that never got its end as skipped."""
        for file in (self._metrics, self._steps, self._worst):
            for number, _ in file.rest():
                self.skipped.add("lines that were cut off", f"{file.path.name} line {number}")

    def _parsed(self, name: str, lines: list[tuple[int, bytes]], parse: Callable[[Any], _Parsed]) -> list[_Parsed]:
        found = []
        for number, line in lines:
            try:
                if len(line) > _MOST_LINE_BYTES:
                    raise ValueError("longer than any line that bc-train writes")
                found.append(parse(json.loads(line)))
            except (ValueError, KeyError, TypeError, RecursionError):
                self.skipped.add("lines that no training writes", f"{name} line {number}")
        return found

    def _next_epoch(self, values: Any) -> Epoch:
        epoch = _epoch_of(values)
        if epoch.epoch <= self._last_epoch:
            raise ValueError("not after the line before")
        self._last_epoch = epoch.epoch
        return epoch

    def _next_step(self, values: Any) -> Step:
        step = Step(
            _count(values["epoch"]),
            _count(values["batch"]),
            _count(values["batches"]),
            _count(values["samples"]),
            _number(values["training_loss"]),
            _number(values["samples_per_s"]),
        )
        if step.samples <= self._last_samples or not 0 < step.batch <= step.batches or not step.epoch:
            raise ValueError("not after the line before")
        self._last_samples = step.samples
        return step

    def _next_worst(self, values: Any) -> WorstPictures:
        epoch = _count(values["epoch"])
        if epoch <= self._last_worst or len(values["frames"]) > WORST_COUNT:
            raise ValueError("not after the line before")
        frames = tuple(_worst_of(each) for each in values["frames"])
        jpegs = tuple(base64.b64decode(each["jpeg"], validate=True) for each in values["frames"])
        for jpeg in jpegs:
            if not is_crop(jpeg):
                raise ValueError("no crop that a network sees")
            decode(jpeg)  # a ValueError for what is none
        self._last_worst = epoch
        return WorstPictures(epoch, frames, jpegs)


def _new_lines(file: FileTail) -> list[tuple[int, bytes]] | None:
    """Number and content of the lines that are new; None if the file is no longer that which was read."""
    try:
        status = file.path.lstat()
        if stat.S_ISLNK(status.st_mode):
            raise RunError(f"{file.path}: a link; a run's files lie in its folder, copy it there")
        if status.st_size > _MOST_BYTES:
            raise RunError(f"{file.path}: larger than {_MOST_BYTES >> 20} MiB, no training writes so much")
        found = file.new_lines()
        while file.is_behind:
            found += file.new_lines()
    except FileNotFoundError:
        return None if file.line_count else []
    except OSError as error:
        raise RunError(f"{file.path}: cannot be read ({error.strerror}); was it written by bc-train?") from None
    return None if file.was_replaced else found


_Parsed = TypeVar("_Parsed", Epoch, Step, WorstPictures)


def _epoch_of(values: Any) -> Epoch:
    bins = tuple(_bin_of(each) for each in values["bins"])
    network, zero, mean = (_errors_of(values[name]) for name in ("validation", "zero", "mean"))
    epoch = Epoch(
        _count(values["epoch"]),
        _number(values["training_loss"]),
        _number(values["validation_loss"]),
        Measures(
            sum(part.frames for part in bins),
            network,
            zero,
            mean,
            bins,
            _number(values["mean"].get("balanced_rmse_deg")),  # earlier versions did not tell it
        ),
        values["is_best"] is True,
        _number(values["seconds"]),
        _number(values["samples_per_s"]),
    )
    if not epoch.epoch:
        raise ValueError("epochs are counted from 1")
    return epoch


def _errors_of(values: Any) -> Errors:
    return Errors(*(_number(values[name]) for name in ("mae_deg", "rmse_deg", "turning_mae_deg", "correlation")))


def _worst_of(values: Any) -> WorstFrame:
    return WorstFrame(
        _text(values["session"]),
        _count(values["row"]),
        _count(values["log_time_ns"]),
        _text(values["log_time_utc"]),
        *(_finite(values[name]) for name in ("predicted_deg", "recorded_deg", "error_deg")),
    )


def _bin_of(values: Any) -> BinErrors:
    part = BinErrors(
        _count(values["bin"]),
        _number(values["low"]),
        _number(values["high"]),
        _count(values["frames"]),
        *(_number(values[name]) for name in ("mae_deg", "rmse_deg", "bias_deg")),
    )
    if not -1.001 <= part.low < part.high <= 1.001 or not part.frames:
        raise ValueError("no bin of steering")
    return part


def _count(value: Any) -> int:
    if type(value) is not int or not 0 <= value <= _MOST:
        raise ValueError("not a count")
    return value


def _text(value: Any) -> str:
    if type(value) is not str or len(value) > _MOST_CHARACTERS:
        raise ValueError("not a name")
    return value


def _finite(value: Any) -> float:
    if value is None:
        raise ValueError("no number")
    return _number(value)


def _number(value: Any) -> float:
    """NaN for null: JSON has no other way to say that there is no number."""
    if value is None:
        return math.nan
    if type(value) not in (int, float) or not abs(value) <= _LARGEST:
        raise ValueError("not a number")
    return float(value)
