"""The history of a training, read from its run folder, also while the training runs.

metrics.jsonl   one line of JSON an epoch
steps.jsonl     one line of JSON every few batches
worst.jsonl     one line of JSON an epoch

A run is not trusted: a line that no training writes is skipped and named.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

from common import Skipped
from common.untrusted import read_bounded
from model.errors import RunError
from model.runs.history_lines import parse_epoch, parse_step, parse_worst_pictures
from model.runs.training_progress import METRICS_FILE, STEPS_FILE, Epoch, Step
from model.runs.worst_pictures import WORST_FILE, WorstPictures

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
