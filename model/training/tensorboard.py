"""Curves for TensorBoard, in the run's folder, while it is trained.

    bc-train --tensorboard
    tensorboard --logdir runs

TensorBoard is an extra: `pip install ".[tensorboard]"`.
"""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from common.files import write_remedy
from common.versions import install_line
from model.errors import RunError
from model.runs.history import HistoryReader
from model.runs.training_progress import Epoch, Step

FOLDER: Final = "tensorboard"


class TensorBoard:
    """A `Listener` that writes RUN/tensorboard; the steps are the samples learnt from since the run began.

    The history of a resumed run is written first, and hides all that TensorBoard had of this run: no point is
    there twice, and none is missing after a kill.
    """

    def __init__(self, run: Path) -> None:
        """Raises RunError if TensorBoard is not installed."""
        try:
            import torch.utils.tensorboard  # noqa: F401
        except ImportError:
            raise RunError(
                f"--tensorboard needs TensorBoard: install it with `{install_line('tensorboard')}`"
            ) from None
        self._run = run
        self._folder = run / FOLDER
        self._epoch_ends: dict[int, int] = {}  # of each epoch, in samples
        self._file: _EventFile | None = None

    def step(self, step: Step) -> None:
        """Raises RunError if the folder cannot be written, or the run's files cannot be read."""
        with self._opened(step.epoch, step.samples) as file:
            self._add_step(file, step)

    def epoch(self, epoch: Epoch) -> None:
        """Raises RunError if the folder cannot be written, or the run's files cannot be read."""
        with self._opened(epoch.epoch, math.inf) as file:
            self._add_epoch(file, epoch)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()

    @contextlib.contextmanager
    def _opened(self, epoch: int, samples: float) -> Iterator[_EventFile]:
        """The event file; the first time, a new one with the run's history before this epoch and these samples."""
        try:
            if self._file is None:
                self._file = self._new_file(epoch, samples)
            yield self._file
        except OSError as error:
            raise RunError(
                f"{self._folder}: cannot be written ({error.strerror}); {write_remedy(error)}, or go on without"
                " --tensorboard"
            ) from None

    def _new_file(self, epoch: int, samples: float) -> _EventFile:
        # Only now have the files of a resumed run been brought to where it goes on.
        reader = HistoryReader(self._run)
        history, _ = reader.read()
        if len(reader.skipped):
            lines = "; ".join(reader.skipped.lines())
            raise RunError(
                f"{self._run}: nothing for TensorBoard, because some of its files cannot be read: {lines}"
            )
        if self._folder.is_symlink():
            raise RunError(f"{self._folder}: a link; remove it: TensorBoard's files must lie in the run's folder")
        file = _EventFile(self._folder)
        try:
            for step in history.steps:
                if step.samples < samples:
                    self._add_step(file, step)
            for earlier in history.epochs:
                if earlier.epoch < epoch:
                    self._add_epoch(file, earlier)
        except OSError:
            file.close()
            raise
        return file

    def _add_step(self, file: _EventFile, step: Step) -> None:
        self._epoch_ends[step.epoch] = step.samples
        file.add_scalars(step.scalars, step.samples)

    def _add_epoch(self, file: _EventFile, epoch: Epoch) -> None:
        samples = self._epoch_ends.get(epoch.epoch, epoch.epoch)
        file.add_scalars(epoch.scalars, samples)


class _EventFile:
    """A new event file, in which every event is as soon as it was added.

    TensorBoard's own writer, and so torch's SummaryWriter, writes on a thread of its own, which prints its
    traceback when the disk is full.
    """

    def __init__(self, folder: Path) -> None:
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog
        from tensorboard.summary.writer.record_writer import RecordWriter
        from torch.utils.tensorboard import summary

        self._event, self._summary = Event, summary
        folder.mkdir(exist_ok=True)
        s, ns = divmod(time.time_ns(), 10**9)
        name = f"events.out.tfevents.{s:010d}.{ns:09d}.{os.getpid()}"  # read in the order of their names
        self._stream = (folder / name).open("xb")
        self._records = RecordWriter(self._stream)
        self._add(file_version="brain.Event:2")
        self._add(session_log=SessionLog(status=SessionLog.START))  # at step 0: hides all earlier files

    def add_scalars(self, values: Mapping[str, float], samples: int) -> None:
        for tag, value in values.items():
            self._add(step=samples, summary=self._summary.scalar(tag, value))

    def close(self) -> None:
        with contextlib.suppress(OSError):  # of what could not be written when it was added
            self._stream.close()

    def _add(self, **content: object) -> None:
        self._records.write(self._event(wall_time=time.time(), **content).SerializeToString())
        self._stream.flush()
