"""The course of a training, read from its run folder, also while it goes on.

metrics.jsonl   one line of JSON an epoch
steps.jsonl     one line of JSON every few batches
worst.jsonl     one line of JSON an epoch

A run is not trusted: a line that no training writes is left out and named.
"""

from __future__ import annotations

import stat
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Generic, TypeVar

from common import Skipped
from common.file_tail import FileTail
from model.errors import RunError
from model.runs.history_lines import parse_epoch, parse_step, parse_worst_pictures
from model.runs.training_progress import METRICS_FILE, STEPS_FILE, Epoch, Step
from model.runs.worst_pictures import WORST_FILE, WorstPictures

_MAX_BYTES: Final = 64 << 20  # of a file: half a million steps
_MAX_LINE_BYTES: Final = 1 << 20

Line = TypeVar("Line")


@dataclass(frozen=True)
class History:
    """The epochs, steps and worst pictures of a training, each in the order in which they happened."""

    epochs: tuple[Epoch, ...]
    steps: tuple[Step, ...]
    worst: tuple[WorstPictures, ...] = ()

    @property
    def best(self) -> Epoch | None:
        return next((epoch for epoch in reversed(self.epochs) if epoch.is_best), None)


def read_history(run: Path) -> tuple[History, Skipped]:
    """The history of a training by now, and the lines that had to be left out.

    Raises RunError if the folder holds no training, or a file of it is a link, too large or cannot be read.
    """
    reader = HistoryReader(run)
    history, _ = reader.read()
    if not any((run / name).exists() for name in (METRICS_FILE, STEPS_FILE)):
        raise RunError(f"{run}: no training in it ({METRICS_FILE} is missing); `bc-train` makes a run")
    reader.skip_unfinished_lines()
    return history, reader.skipped


def read_epochs(run: Path) -> tuple[Epoch, ...]:
    """The epochs of a training by now, those alone; broken lines are left out. Raises RunError as `read_history`
    does; no epochs where there is no training."""
    file = _HistoryFile(run / METRICS_FILE, parse_epoch, lambda epoch: epoch.epoch, Skipped())
    return tuple(file.read() or ())


class HistoryReader:
    """Reads a run's files as they grow; `skipped` holds the lines that had to be left out."""

    def __init__(self, run: Path) -> None:
        self._run = run
        self._begin()

    def _begin(self) -> None:
        self.skipped = Skipped()
        self._metrics = _HistoryFile(
            self._run / METRICS_FILE, parse_epoch, lambda epoch: epoch.epoch, self.skipped
        )
        self._steps = _HistoryFile(self._run / STEPS_FILE, parse_step, lambda step: step.samples, self.skipped)
        self._worst = _HistoryFile(
            self._run / WORST_FILE, parse_worst_pictures, lambda worst: worst.epoch, self.skipped
        )

    def read(self) -> tuple[History, bool]:
        """The history that was added since the last call, and whether the files were replaced, as by a resumed
        training: then all is read anew. Raises RunError as `read_history` does, and if the folder is gone."""
        if not self._run.is_dir():
            raise RunError(f"{self._run}: no such run folder; a training that is stopped early removes its folder")
        added = self._read_files()
        if added is not None:
            return added, False
        self._begin()
        return self._read_files() or History((), ()), True

    def _read_files(self) -> History | None:
        # Metrics first: the steps and the worst frames of every epoch that is read are then there too.
        epochs, steps, worst = self._metrics.read(), self._steps.read(), self._worst.read()
        if epochs is None or steps is None or worst is None:
            return None
        return History(tuple(epochs), tuple(steps), tuple(worst))

    def skip_unfinished_lines(self) -> None:
        """Count a last line that never got its end as skipped."""
        for file in (self._metrics, self._steps, self._worst):
            file.skip_unfinished_line()


class _HistoryFile(Generic[Line]):
    """A file of JSON lines in the order of time."""

    def __init__(
        self, path: Path, parse: Callable[[bytes], Line], order: Callable[[Line], int], skipped: Skipped
    ) -> None:
        self._tail = FileTail(path, _MAX_LINE_BYTES)
        self._parse = parse
        self._order = order
        self._skipped = skipped
        self._last = 0

    def read(self) -> list[Line] | None:
        """The lines that were added since the last call; None if the file was replaced."""
        lines = self._new_lines()
        if lines is None:
            return None
        parsed = []
        for number, content in lines:
            try:
                parsed.append(self._next(content))
            except (ValueError, KeyError, TypeError, RecursionError):
                self._skipped.add("lines that no training writes", f"{self._tail.path.name} line {number}")
        return parsed

    def skip_unfinished_line(self) -> None:
        for number, _ in self._tail.rest():
            self._skipped.add("lines that were cut off", f"{self._tail.path.name} line {number}")

    def _next(self, content: bytes) -> Line:
        if len(content) > _MAX_LINE_BYTES:
            raise ValueError("longer than any line that bc-train writes")
        line = self._parse(content)
        if self._order(line) <= self._last:
            raise ValueError("not after the line before")
        self._last = self._order(line)
        return line

    def _new_lines(self) -> list[tuple[int, bytes]] | None:
        """Number and content of the lines that are new; None if the file is no longer that which was read."""
        file = self._tail
        try:
            status = file.path.lstat()
            if stat.S_ISLNK(status.st_mode):
                raise RunError(f"{file.path}: a link; copy its target into the run's folder")
            if status.st_size > _MAX_BYTES:
                raise RunError(f"{file.path}: larger than {_MAX_BYTES >> 20} MiB, more than a training writes")
            lines = file.new_lines(status.st_size)
            while file.is_behind:
                lines += file.new_lines(status.st_size)
        except FileNotFoundError:
            return None if file.line_count else []
        except OSError as error:
            raise RunError(
                f"{file.path}: cannot be read ({error.strerror}); was it written by bc-train?"
            ) from None
        return None if file.was_replaced else lines
