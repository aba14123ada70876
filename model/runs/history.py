"""The history of a training, read from its run folder, also while the training runs.

metrics.jsonl   one line of JSON an epoch
steps.jsonl     one line of JSON every few batches
worst.jsonl     one line of JSON an epoch

A run is not trusted: a line that no training writes is skipped and named.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, TypeVar

from common import Skipped
from common.car import MAX_STEERING_DEG
from common.untrusted import read_bounded
from dataset.prediction_targets import TARGET_NAMES
from model.errors import RunError
from model.metrics import BinErrors, Errors, Measures, TargetErrors
from model.runs.answer_scale import AnswerScale
from model.runs.training_progress import METRICS_FILE, STEPS_FILE, Epoch, Step
from model.runs.worst_pictures import WORST_COUNT, WORST_FILE, WorstFrame, WorstPictures

_MAX_BYTES: Final = 64 << 20  # half a million steps
_MAX_LINE_BYTES: Final = 1 << 20

Line = TypeVar("Line")


@dataclass(frozen=True)
class History:
    """The epochs, steps and worst pictures of a training, in the order in which they happened."""

    epochs: tuple[Epoch, ...]
    steps: tuple[Step, ...]
    worst: tuple[WorstPictures, ...] = ()

    @property
    def best(self) -> Epoch | None:
        return next((epoch for epoch in reversed(self.epochs) if epoch.is_best), None)


def read_history(run: Path) -> tuple[History, Skipped]:
    """The history of a training until now (empty before its first line), and the lines that were skipped.

    Raises RunError if one of the files is a link, is too large or cannot be read.
    """
    skipped = Skipped()
    # Metrics first: a training writes the steps and the worst frames of an epoch before its metrics.
    epochs = _read(run / METRICS_FILE, parse_epoch, lambda epoch: epoch.epoch, skipped)
    steps = _read(run / STEPS_FILE, parse_step, lambda step: step.samples, skipped)
    worst = _read(run / WORST_FILE, parse_worst_pictures, lambda worst: worst.epoch, skipped)
    return History(epochs, steps, worst), skipped


def read_epochs(run: Path) -> tuple[Epoch, ...]:
    """The epochs of a training until now, without broken lines. Raises RunError as `read_history` does."""
    return _read(run / METRICS_FILE, parse_epoch, lambda epoch: epoch.epoch, Skipped())


def _read(
    path: Path, parse: Callable[[bytes], Line], order: Callable[[Line], int], skipped: Skipped
) -> tuple[Line, ...]:
    """The parsed lines of a file. A line whose `order` is not above that of the line before is skipped."""
    if path.is_symlink():
        raise RunError(f"{path}: a link; copy its target into the run's folder")
    try:
        data = read_bounded(path, _MAX_BYTES)
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise RunError(f"{path}: cannot be read ({error.strerror}); was it written by bc-train?") from None
    parsed: list[Line] = []
    last = 0
    for number, content in enumerate(data.splitlines(keepends=True), 1):
        name = f"{path.name} line {number}"
        if not content.endswith((b"\n", b"\r")):
            skipped.add("lines that were cut off", name)
            break
        try:
            if len(content) > _MAX_LINE_BYTES:
                raise ValueError("longer than any line that bc-train writes")
            line = parse(content)
            if order(line) <= last:
                raise ValueError("not after the line before")
        except (ValueError, KeyError, TypeError, RecursionError):
            skipped.add("lines that no training writes", name)
        else:
            parsed.append(line)
            last = order(line)
    return tuple(parsed)


_LARGEST_COUNT: Final = 1 << 62  # samples or ns; no training reaches it
_LARGEST_NUMBER: Final = 1e100  # its square is still a number
_MAX_CHARACTERS: Final = 1000  # of a session's name

Part = TypeVar("Part", AnswerScale, BinErrors, Errors, Step, TargetErrors, WorstFrame)


def parse_epoch(line: bytes) -> Epoch:
    values = json.loads(line)
    if not isinstance(values, dict):
        raise TypeError("no object")
    answers, learnt = values.get("answers"), values.get("learnt")  # earlier versions have neither
    return Epoch(
        _count(values["epoch"], minimum=1),
        _number(values["training_loss"]),
        _number(values["validation_loss"]),
        parse_measures(values, "validation"),
        values["is_best"] is True,
        _number(values["seconds"]),
        _number(values["samples_per_s"]),
        AnswerScale() if answers is None else _part(AnswerScale, {"curve": 0.0, **answers}),  # earlier: no curve
        None if learnt is None else _part(Errors, learnt),
        tuple(_part(TargetErrors, target) for target in values.get("targets", ())),
        _number(learnt.get("driving_error")) if isinstance(learnt, dict) else math.nan,  # earlier: none
    )


def parse_measures(values: Any, network: str) -> Measures:
    """The measures in a line; `network` is the field with the network's errors."""
    bins = tuple(_part(BinErrors, part) for part in values["bins"])
    if not all(part.frames and -1.001 <= part.low < part.high <= 1.001 for part in bins):
        raise ValueError("no bin of steering")
    network_errors, zero, mean = (_part(Errors, values[name]) for name in (network, "zero", "mean"))
    balanced_rmse_deg = _number(values["mean"].get("balanced_rmse_deg"))  # earlier versions have none
    frames = sum(part.frames for part in bins)
    return Measures(frames, network_errors, zero, mean, bins, balanced_rmse_deg, _max_deg(values))


def parse_step(line: bytes) -> Step:
    step = _part(Step, json.loads(line))
    if not (step.epoch and step.samples and 1 <= step.batch <= step.batches):
        raise ValueError("no batch of an epoch")
    return step


def parse_worst_pictures(line: bytes) -> WorstPictures:
    from dataset.preprocessing import decode, may_be_crop

    values = json.loads(line)
    if len(values["frames"]) > WORST_COUNT:
        raise ValueError("more frames than a training keeps")
    frames = tuple(_part(WorstFrame, frame) for frame in values["frames"])
    if any(math.isnan(frame.predicted_deg + frame.recorded_deg + frame.error_deg) for frame in frames):
        raise ValueError("no steering of a frame")
    jpegs = tuple(base64.b64decode(frame["jpeg"], validate=True) for frame in values["frames"])
    for jpeg in jpegs:
        if not may_be_crop(jpeg):
            raise ValueError("no crop that a network sees")
        decode(jpeg)  # raises ValueError if it is no picture
    return WorstPictures(_count(values["epoch"], minimum=1), frames, jpegs, _max_deg(values))


def _max_deg(values: Any) -> float | None:
    if values.get("max_deg", MAX_STEERING_DEG) is None:
        return None
    angle_deg = _number(values.get("max_deg", MAX_STEERING_DEG))
    if not 0 < angle_deg < 90:
        raise ValueError("no angle of the wheels")
    return angle_deg


def _part(kind: type[Part], values: Mapping[str, Any]) -> Part:
    """A dataclass from the fields in `values`, each checked by its type. Other fields are ignored."""
    return kind(**{field.name: _CHECKS[str(field.type)](values[field.name]) for field in fields(kind)})


def _count(value: Any, minimum: int = 0) -> int:
    if type(value) is not int or not minimum <= value <= _LARGEST_COUNT:
        raise ValueError("not a count")
    return value


def _number(value: Any) -> float:
    """A number; NaN for null, because JSON has no NaN."""
    if value is None:
        return math.nan
    if type(value) not in (int, float) or not abs(value) <= _LARGEST_NUMBER:
        raise ValueError("not a number")
    return float(value)


def _text(value: Any) -> str:
    if type(value) is not str or len(value) > _MAX_CHARACTERS:
        raise ValueError("not a name")
    return value


def _target(value: Any) -> str:
    if value not in TARGET_NAMES[1:]:
        raise ValueError("not a target other than steering")
    return str(value)


_CHECKS: Final[Mapping[str, Callable[[Any], Any]]] = {
    "int": _count,
    "float": _number,
    "str": _text,
    "TargetName": _target,
}
