"""A run's files: their names, atomic writing, and the lock of the process that trains the run."""

from __future__ import annotations

import contextlib
import json
import math
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from common import atomic_file
from common.files import write_remedy
from common.locks import is_being_written, try_lock
from model.errors import RunError, RunWriteError

WEIGHTS: Final = "model.safetensors"
CONFIG: Final = "config.json"
"""A folder with this file is a run."""
LAST: Final = "last"
"""The folder in a run with the state of its training, from which a stopped training continues."""
CHECKPOINT: Final = "checkpoint.safetensors"
TRAINING_LOCK: Final = "last/.lock"
"""A file that is locked while a process trains the run."""
RESULTS_FILE: Final = "results.jsonl"
"""The results of a run's evaluations, one a line: see kept_results.py."""


@contextlib.contextmanager
def replaced_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to, which replaces `path` at the end. Raises RunWriteError, and leaves the
    old file, if the disk is full or cannot be written to."""
    with run_write_errors(path), atomic_file(path, overwrite=True) as part:
        yield part


@contextlib.contextmanager
def run_write_errors(path: Path) -> Iterator[None]:
    """Raise RunWriteError, which names `path`, for an OSError in the block."""
    try:
        yield
    except OSError as error:
        why = error.strerror or error
        raise RunWriteError(f"{path}: cannot be written ({why}); {write_remedy(error)}") from None


def append_json_line(path: Path, values: dict[str, Any]) -> None:
    """Add a line of JSON; NaN and infinite numbers become null. If a full disk or a kill cut off the line before,
    end that line first."""
    line = json.dumps(without_nan(values), allow_nan=False).encode() + b"\n"
    with run_write_errors(path), path.open("a+b") as stream:
        if stream.seek(0, os.SEEK_END):
            stream.seek(-1, os.SEEK_END)
            line = line if stream.read(1) == b"\n" else b"\n" + line
        stream.write(line)


def keep_json_lines(path: Path, wanted: Callable[[dict[str, Any]], bool]) -> None:
    """Remove the lines that are not wanted, and broken ones, which a killed training leaves."""
    kept = []
    with contextlib.suppress(FileNotFoundError):
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            with contextlib.suppress(ValueError, KeyError, TypeError, RecursionError):
                if wanted(json.loads(line)):
                    kept.append(line)
    with replaced_file(path) as part:
        part.write_text("".join(f"{line}\n" for line in kept), encoding="utf-8")


def without_nan(value: Any) -> Any:
    """The value with None in place of NaN and infinite numbers, which JSON cannot hold."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
            raise RunError(f"{run}: is being trained by another process; wait for it")
        yield


def is_being_trained(run: Path) -> bool:
    """True while a process on this machine trains the run."""
    return is_being_written(run / TRAINING_LOCK)
