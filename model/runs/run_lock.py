"""A lock that lets one process at a time train a run."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

from common.locks import is_being_written, try_lock
from model.errors import RunError
from model.runs.run_files import TRAINING_LOCK


@contextlib.contextmanager
def locked_for_training(run: Path) -> Iterator[None]:
    """Hold the lock of a run's folder. Raises RunError if another process is training the run."""
    path = run / TRAINING_LOCK
    path.parent.mkdir(exist_ok=True)
    with path.open("ab") as stream:
        for _ in range(50):  # a process that only tests the lock holds it for a moment
            if try_lock(stream):
                break
            time.sleep(0.02)
        else:
            raise RunError(f"{run}: is being trained by another process; wait for it, or give another --name")
        yield


def is_being_trained(run: Path) -> bool:
    """Whether a process of this machine trains the run."""
    return is_being_written(run / TRAINING_LOCK)
