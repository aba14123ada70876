"""Curves for TensorBoard, written to the run's folder during the training.

    bc-train --tensorboard
    tensorboard --logdir runs

TensorBoard is an extra: `pip install ".[tensorboard]"`.
"""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import BinaryIO, Final

from common.files import write_remedy
from common.versions import install_line
from model.errors import RunError
from model.runs.history import read_history
from model.runs.training_progress import Epoch, Step

FOLDER: Final = "tensorboard"


class TensorBoard:
    """A `Listener` that writes RUN/tensorboard. Its steps are the samples learnt since the run began.

    With the first event, it writes the run's whole history, which hides all earlier points of this run. So no
    point is shown twice, and none is missing after a kill. TensorBoard's writer and torch's SummaryWriter are not
    used: they write on a thread, which prints its traceback when the disk is full.
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
        self._epoch_ends: dict[int, int] = {}  # samples learnt at the end of each epoch
        self._stream: BinaryIO | None = None

    def step(self, step: Step) -> None:
        """Raises RunError if the folder cannot be written, or the run's files cannot be read."""
        self._add(step)

    def epoch(self, epoch: Epoch) -> None:
        """Raises RunError if the folder cannot be written, or the run's files cannot be read."""
        self._add(epoch)

    def close(self) -> None:
        if self._stream is not None:
            with contextlib.suppress(OSError):  # it was already reported when a write failed
                self._stream.close()

    def _add(self, event: Step | Epoch) -> None:
        try:
            events = [event] if self._stream is not None else self._history()
            stream = self._stream or self._open()
            for entry in events:
                self._write_curves(stream, entry)
        except OSError as error:
            raise RunError(
                f"{self._folder}: cannot be written ({error.strerror}); {write_remedy(error)}, or continue without"
                " --tensorboard"
            ) from None

    def _history(self) -> list[Step | Epoch]:
        """All steps and epochs including the first event. Read late, because a resumed run first cuts its
        files."""
        history, skipped = read_history(self._run)
        if len(skipped):
            lines = "; ".join(skipped.lines())
            raise RunError(
                f"{self._run}: nothing for TensorBoard, because some of its files cannot be read: {lines}"
            )
        return [*history.steps, *history.epochs]

    def _open(self) -> BinaryIO:
        from tensorboard.compat.proto.event_pb2 import SessionLog

        if self._folder.is_symlink():
            raise RunError(f"{self._folder}: a link; remove it: TensorBoard's files must be in the run's folder")
        self._folder.mkdir(exist_ok=True)
        s, ns = divmod(time.time_ns(), 10**9)
        name = f"events.out.tfevents.{s:010d}.{ns:09d}.{os.getpid()}"  # read in the order of their names
        self._stream = (self._folder / name).open("xb")
        _write(self._stream, file_version="brain.Event:2")
        _write(self._stream, session_log=SessionLog(status=SessionLog.START))  # at step 0: hides earlier files
        return self._stream

    def _write_curves(self, stream: BinaryIO, event: Step | Epoch) -> None:
        from torch.utils.tensorboard import summary

        if isinstance(event, Step):
            self._epoch_ends[event.epoch] = event.samples
        samples = self._epoch_ends.get(event.epoch, event.epoch)
        for tag, value in event.scalars.items():
            _write(stream, step=samples, summary=summary.scalar(tag, value))


def _write(stream: BinaryIO, **content: object) -> None:
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.summary.writer.record_writer import RecordWriter

    RecordWriter(stream).write(Event(wall_time=time.time(), **content).SerializeToString())
    stream.flush()
