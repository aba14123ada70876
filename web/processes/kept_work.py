"""Work on many pictures: one separate process at a time does it, and reports its progress. The cache keeps the
result as a file. Its key is a checksum of the inputs."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

import behavioural_cloning_toolkit
from common import UserError, atomic_file
from common.errors import printable
from common.output import print_result
from common.process_settings import end_with_parent
from model.runs.run_files import CONFIG, WEIGHTS
from web.errors import WebError
from web.folders.file_versions import version_of

_ROOT: Final = str(Path(behavioural_cloning_toolkit.__file__).parent)


def start_process(module: str, words: list[str], temporary: str) -> subprocess.Popen[bytes]:
    """Start a process that calls `main()` of a module with these words as arguments. Its temporary files are in
    the folder `temporary`, because a killed process leaves them behind. Raises OSError if it does not start."""
    start = f"import sys; sys.path.append(sys.argv.pop(1)); from {module} import main; main()"
    return subprocess.Popen(
        [sys.executable, "-P", "-c", start, _ROOT, *words],
        stdin=subprocess.PIPE,  # it ends with this process
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "TMPDIR": temporary},
        start_new_session=True,
    )


def reports(process: subprocess.Popen[bytes]) -> Iterator[dict[str, Any]]:
    assert process.stdout is not None  # noqa: S101
    with process.stdout as lines:
        for line in lines:
            with contextlib.suppress(ValueError):
                yield json.loads(line)


def report(**values: object) -> None:
    """Report progress or a `problem` from the process to the server."""
    print_result(json.dumps(values))


def counter(step: int = 1, **more: object) -> Callable[[], None]:
    """A function that reports `step` pictures more at each call."""
    counts = itertools.count(step, step)
    return lambda: report(pictures=next(counts), **more)


def run_in_process(work: Callable[..., object], niceness: int = 0) -> None:
    """Call `work` with this process's arguments, and report its errors."""
    if sys.platform != "win32":
        os.nice(niceness)
    end_with_parent()
    try:
        work(*sys.argv[1:])
    except UserError as error:
        report(problem=printable(str(error)))
    except OSError as error:
        report(problem=printable(f"{error.filename or sys.argv[1]}: {error.strerror}"))
    except MemoryError:
        report(problem="not enough memory")


Result = TypeVar("Result")

_KEY: Final = re.compile(r"[0-9a-f]{64}")
_SHOWN: Final = ("is_begun", "stage", "pictures", "total", "left_s", "problem")  # of a work, on its page


@dataclass
class Work:
    total: int  # pictures
    pictures: int = 0
    stage: str = ""  # if it has several; each has its own total
    is_begun: bool = False  # else it waits for other work
    is_done: bool = False
    is_stopped: bool = False
    problem: str = ""
    left_s: float | None = None
    """Remaining time; None while it is unknown."""
    _first: tuple[int, float] | None = None
    """Pictures and time of the first report, so that the start does not count."""

    def advance_to(self, pictures: int, total: int | None = None, stage: str = "") -> None:
        if stage != self.stage:
            self.stage, self._first, self.left_s = stage, None, None
        self.total = self.total if total is None else total
        self.pictures = min(self.total, pictures)
        now_s = time.monotonic()
        if self._first is None:
            self._first = self.pictures, now_s
        elif self.pictures > self._first[0]:
            picture_s = (now_s - self._first[1]) / (self.pictures - self._first[0])
            self.left_s = picture_s * (self.total - self.pictures)


class KeptWork:
    """The works of one kind: kept, running and waiting. The folder may be deleted at any time."""

    def __init__(self, folder: Path, module: str, stopped: str) -> None:
        """`module` has the `main()` of the process. Its arguments are words and the path of the result. `stopped`
        is the message for stopped work."""
        self._folder = folder
        self._module = module
        self._stopped = stopped
        self._pool = ThreadPoolExecutor(1, f"work in {folder.name}")
        self._lock = threading.Lock()
        self._requested: dict[str, Work] = {}
        self._running: tuple[Work, subprocess.Popen[bytes]] | None = None
        self._is_closed = False

    def path(self, key: str) -> Path:
        return self._folder / f"{key}.npz"

    def find(self, key: str, read: Callable[[Mapping[str, NDArray[Any]]], Result]) -> Result | None:
        """What `read` makes of the columns of a key; None if the key is invalid or not kept (any more)."""
        if not _KEY.fullmatch(key):
            return None
        try:
            with np.load(self.path(key), allow_pickle=False) as kept:
                return read(kept)
        except FileNotFoundError:
            return None

    def requested(self, key: str) -> Work | None:
        with self._lock:
            return self._requested.get(key)

    def start(self, key: str, pictures: int, words: Sequence[str]) -> None:
        with self._lock:
            before = self._requested.get(key)
            if before is not None and not (before.is_done or before.is_stopped):
                return
            self._requested[key] = work = Work(pictures)
        self._pool.submit(self._run, work, [*words, str(self.path(key).absolute())])

    def state(
        self, key: str, about: Callable[[], object | None], start: Callable[[], None] | None
    ) -> dict[str, object]:
        """The state of a work for its page: `about()` if the result is kept, else progress and problem. If it is
        not kept, call `start`."""
        if (result := about()) is not None:
            return {"key": key, "about": msgspec.to_builtins(result), "problem": ""}
        if start is not None:
            start()
        state: dict[str, object] = {"key": key, "about": None, "problem": ""}
        if work := self.requested(key):
            state |= {name: getattr(work, name) for name in _SHOWN}
        return state

    def stop(self, key: str) -> None:
        """Stop a work for all pages, unless it is done, or was never requested."""
        with self._lock:
            work = self._requested.get(key)
            if work is None or work.is_done:
                return
            work.is_stopped = True
            work.problem = work.problem or self._stopped
            if self._running is not None and self._running[0] is work:
                self._running[1].kill()

    def close(self) -> None:
        self._is_closed = True
        with self._lock:
            if self._running is not None:
                self._running[1].kill()
        self._pool.shutdown(cancel_futures=True)

    def _run(self, work: Work, words: list[str]) -> None:
        try:
            with tempfile.TemporaryDirectory(prefix="bc-web-", ignore_cleanup_errors=True) as temporary:
                self._run_in(temporary, work, words)
        except OSError as error:
            work.problem = f"the process does not start: {error.strerror}"
        finally:
            with self._lock:
                self._running = None
            work.is_done = True

    def _run_in(self, temporary: str, work: Work, words: list[str]) -> None:
        with self._lock:
            if self._is_closed or work.is_stopped:
                return
            work.is_begun = True
            process = start_process(self._module, words, temporary)
            self._running = work, process
        with process:
            for message in reports(process):
                _update(work, message)
        if process.returncode and not work.problem:
            work.problem = f"the process ended with exit code {process.returncode}; try again"


def run_fingerprint(run: Path) -> str:
    """The fingerprint of a run's weights and settings. Raises WebError for a run without weights."""
    return _fingerprint(run, version_of(run / WEIGHTS, run / CONFIG))


@lru_cache(maxsize=1024)
def _fingerprint(run: Path, version: str) -> str:
    digest = hashlib.sha256()
    try:
        for name in (WEIGHTS, CONFIG):
            with (run / name).open("rb") as stream:
                digest.update(hashlib.file_digest(stream, "sha256").digest())
    except OSError as error:
        problem = f"{error.filename}: {error.strerror}"
        raise WebError(f"{problem}; a run has weights after its first epoch", 409) from None
    return digest.hexdigest()


def write_result(path: Path, **columns: NDArray[Any]) -> None:
    """Write a result, whole or not at all."""
    with atomic_file(path, overwrite=True) as part, part.open("wb") as stream:
        np.savez(stream, **columns)  # type: ignore[arg-type]


def _update(work: Work, message: Mapping[str, Any]) -> None:
    with contextlib.suppress(ValueError, KeyError, TypeError):
        if "problem" in message:
            work.problem = printable(str(message["problem"]))
        else:
            work.advance_to(int(message["pictures"]), message.get("total"), message.get("stage", ""))
