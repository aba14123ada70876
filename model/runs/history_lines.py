"""Lines of a run's metrics.jsonl, steps.jsonl and worst.jsonl, checked: a run may come from somebody else.

Each function raises ValueError or RecursionError for a line that no training writes.
"""

from __future__ import annotations

import math
from typing import Any, Final

import msgspec

from dataset.preprocess import decode, is_crop
from model.metrics import BinErrors, Errors, Measures
from model.runs.training_progress import Epoch, Step
from model.runs.worst_pictures import WORST_COUNT, WorstPictures
from model.worst_moments import WorstFrame

_LARGEST_INT: Final = 1 << 62  # samples, or ns; beyond it, nothing was ever trained
_LARGEST_FLOAT: Final = 1e100  # its square is still a number
_MOST_CHARACTERS: Final = 1000  # of a session's name


class _EpochLine(msgspec.Struct):
    epoch: int
    training_loss: float
    validation_loss: float
    validation: Errors
    zero: Errors
    mean: Errors
    bins: tuple[BinErrors, ...]
    is_best: bool
    seconds: float
    samples_per_s: float


class _WorstLine(msgspec.Struct):
    epoch: int
    frames: tuple[WorstFrame, ...]


class _Jpeg(msgspec.Struct):
    jpeg: bytes


def parse_epoch(line: bytes) -> Epoch:
    values = _parsed(line)
    stored = msgspec.convert(values, _EpochLine)
    if stored.epoch < 1:
        raise ValueError("epochs are counted from 1")
    for part in stored.bins:
        if not -1.001 <= part.low < part.high <= 1.001 or part.bin < 0 or part.frames < 1:
            raise ValueError("no bin of steering")
    mean_balanced_rmse_deg = values["mean"].get("balanced_rmse_deg", math.nan)  # earlier versions have none
    measures = Measures(
        sum(part.frames for part in stored.bins),
        stored.validation,
        stored.zero,
        stored.mean,
        stored.bins,
        msgspec.convert(mean_balanced_rmse_deg, float),
    )
    return Epoch(
        stored.epoch,
        stored.training_loss,
        stored.validation_loss,
        measures,
        stored.is_best,
        stored.seconds,
        stored.samples_per_s,
    )


def parse_step(line: bytes) -> Step:
    step = msgspec.convert(_parsed(line), Step)
    if step.epoch < 1 or not 0 < step.batch <= step.batches:
        raise ValueError("no batch of an epoch")
    return step


def parse_worst_pictures(line: bytes) -> WorstPictures:
    values = _parsed(line)
    stored = msgspec.convert(values, _WorstLine)
    if stored.epoch < 1 or len(stored.frames) > WORST_COUNT:
        raise ValueError("no worst frames of an epoch")
    for frame in stored.frames:
        if min(frame.row, frame.log_time_ns) < 0 or len(frame.session + frame.log_time_utc) > _MOST_CHARACTERS:
            raise ValueError("no frame of a session")
        if not math.isfinite(frame.predicted_deg + frame.recorded_deg + frame.error_deg):
            raise ValueError("no steering of a frame")
    jpegs = tuple(picture.jpeg for picture in msgspec.convert(values["frames"], tuple[_Jpeg, ...]))
    for jpeg in jpegs:
        if not is_crop(jpeg):
            raise ValueError("no crop that a network sees")
        decode(jpeg)  # a ValueError for what is none
    return WorstPictures(stored.epoch, stored.frames, jpegs)


def _parsed(line: bytes) -> Any:
    """The JSON of a line, in which null is NaN: JSON has no other way to say that a number does not exist."""
    return _without_null(msgspec.json.decode(line))


def _without_null(value: Any) -> Any:
    if value is None:
        return math.nan
    if isinstance(value, dict):
        return {name: _without_null(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_without_null(each) for each in value]
    if isinstance(value, int | float) and abs(value) > (
        _LARGEST_INT if isinstance(value, int) else _LARGEST_FLOAT
    ):
        raise ValueError("a number beyond those of a training")
    return value
