"""A run's files: their names, atomic writing, the lock of the process that trains the run, and its results.

results.jsonl has one line for each evaluation: its numbers, the time, and the SHA-256 of the weights, because more
training changes them. Files of runs are not trusted: an invalid line is skipped and counted. Needs no PyTorch.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import secrets
import shlex
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal

import msgspec

from common import atomic_file
from common.errors import did_you_mean, first_of
from common.files import write_remedy
from common.locks import is_being_written, try_lock
from common.untrusted import read_bounded
from model.errors import RunError, RunWriteError
from model.runs.network_of_run import picture_of

RUNS: Final = Path("runs")
"""The default folder of runs."""


def new_run_name() -> str:
    """A name for a new run: the date, the time and six random digits, because several trainings may begin in the
    same second."""
    return f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}-{secrets.token_hex(3)}"


def run_argument(run: Path) -> str:
    """A run as an argument of a command, quoted for a shell: the name of a run in `RUNS`, else the path."""
    return shlex.quote(run.name if run.parent == RUNS else str(run))


def suggest_runs(name: str, names: Sequence[str], runs: Path) -> str:
    """A line that suggests runs in `runs` for a mistyped `name`."""
    if not names:
        return f"none is in {runs}: `bc-train` makes one"
    if meant := did_you_mean(name, names):
        return meant
    return f"in {runs} are {first_of(names)}"


WEIGHTS: Final = "model.safetensors"
CONFIG: Final = "config.json"
"""A folder with this file is a run."""
LAST: Final = "last"
"""The folder in a run with the state of its training, from which a stopped training continues."""
CHECKPOINT: Final = "checkpoint.safetensors"
TRAINING_LOCK: Final = "last/.lock"
"""A file that is locked while a process trains the run."""
RESULTS_FILE: Final = "results.jsonl"
"""The results of a run's evaluations, one a line."""


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


FORMAT: Final = 4
DRIVABLE: Final = (1, 2, 3, 4)
"""Format 1 has fewer training settings. In format 2, the last layer may hold the answer scale. Up to format 3, the
only target is steering."""
MAX_CONFIG_BYTES: Final = 256 << 20  # a config.json names every log: 100,000 take 160 MB


def load_config(folder: Path) -> dict[str, Any]:
    """The run's config.json. Raises RunError if it is damaged, or newer than this toolkit."""
    path = config_folder(folder) / CONFIG
    try:
        config = json.loads(read_bounded(path, MAX_CONFIG_BYTES))
        version = config["format"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise RunError(f"{path}: cannot be read ({error}); was it written by bc-train?") from None
    if version not in DRIVABLE:
        raise RunError(
            f"{path}: of format {version}, this toolkit reads {DRIVABLE[0]} to {FORMAT}; update the toolkit"
        )
    picture_of(config, path)  # raises RunError for another preprocessing
    return dict(config)


def config_folder(folder: Path) -> Path:
    """The folder of the run: NAME for both NAME and NAME/last."""
    return folder.parent if is_last_weights(folder) else folder


def weights_path(folder: Path) -> Path:
    """The file with the weights of a run, or of its last epoch (NAME/last)."""
    return folder / (CHECKPOINT if is_last_weights(folder) else WEIGHTS)


def is_last_weights(folder: Path) -> bool:
    """True for NAME/last, the weights after a run's last epoch."""
    return folder.name == LAST and (folder / CHECKPOINT).is_file()


def weights_checksum(folder: Path) -> str:
    """SHA-256 of the run's weights. A drive's log names its network by it."""
    with weights_path(folder).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


_MAX_BYTES: Final = 64 << 20  # a hundred thousand results

Way = Literal["frames", "recording", "simulator", "supervised"]
"""In a "supervised" drive, a person took over from the network (`bc-drive --takeover me`). Only earlier versions
write "recording": a network drove along a recording."""


class KeptResult(msgspec.Struct, frozen=True):
    measured_at: str  # UTC, ISO 8601
    way: Way
    weights_sha256: str
    result: dict[str, Any]  # as `bc-eval --json` prints it; of a supervised drive, as `drive.driven_car` makes it


def keep_result(run: Path, way: Way, result: Mapping[str, Any]) -> None:
    """Add a result of the run's kept weights, or of its last ones (NAME/last). Raises RunWriteError if the folder
    cannot be written to."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    kept = KeptResult(now, way, weights_checksum(run), dict(result))
    append_json_line(config_folder(run) / RESULTS_FILE, msgspec.to_builtins(kept))


def kept_results(run: Path) -> tuple[list[KeptResult], int]:
    """The results in a run's folder, the oldest first, and the number of invalid lines."""
    path = run / RESULTS_FILE
    try:
        content = read_bounded(path, _MAX_BYTES)
    except FileNotFoundError:
        return [], 0
    except (OSError, ValueError) as error:
        raise RunError(f"{path}: cannot be read ({error}); remove it, and measure again") from None
    results, lines = [], [line for line in content.splitlines() if line.strip()]
    for line in lines:
        try:
            results.append(msgspec.convert(json.loads(line), KeptResult))
        except (ValueError, RecursionError):  # msgspec's errors are ValueErrors
            continue
    return results, len(lines) - len(results)
