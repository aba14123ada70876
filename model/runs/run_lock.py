"""A lock that lets one process at a time train a run."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

from common.locks import try_lock
from model.errors import RunError
from model.runs.checkpoint import LAST


@contextlib.contextmanager
def locked_for_training(run: Path) -> Iterator[None]:
    """Hold the lock of a run's folder. Raises RunError if another process is training the run."""
    folder = run / LAST
    folder.mkdir(exist_ok=True)
    with (folder / ".lock").open("ab") as stream:
        for _ in range(50):  # a process that only tests the lock holds it for a moment
            if try_lock(stream):
                break
            time.sleep(0.02)
        else:
            raise RunError(f"{run}: is being trained by another process; wait for it, or give another --name")
        yield
