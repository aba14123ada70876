"""The steering that a run's network predicts for a log: made by a process of its own, one at a time, and kept in
the cache by the fingerprints of the log and of the run's weights."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import subprocess
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from common.errors import printable
from common.interrupts import leave_signals_to_main_thread
from common.location import Location
from model.runs.run_files import CONFIG, WEIGHTS
from web.data.file_versions import version_of
from web.data.own_process import own_process
from web.data.project_folders import as_word
from web.errors import WebError

STOPPED: Final = "it was stopped; choose the run again to begin anew"
_FORMAT: Final = 1  # of the files that are kept


class WorstMoment(msgspec.Struct, frozen=True):
    """A moment at which the network is off the most; `error_deg` is positive where it steers too far right."""

    row: int
    error_deg: float
    predicted_deg: float
    recorded_deg: float


class Measured(msgspec.Struct, frozen=True):
    """The errors of a network. RMSEs are None where nothing was recorded to compare with."""

    frames: int
    rmse_deg: float | None
    mean_rmse_deg: float | None  # of always predicting the mean
    max_deg: float | None  # the wheels' angle at steering 1; None: unknown
    worst: list[WorstMoment]
    notes: list[str]  # what was left out


@dataclass(frozen=True)
class Predicted:
    about: Measured
    row: NDArray[np.int64]  # (N,), of each picture of the centre camera that decodes
    steering: NDArray[np.float64]  # (N,), -1 (left) to 1 (right), before any clamp

    def at(self, rows: NDArray[np.int64]) -> NDArray[np.float64]:
        """The steering at rows (M,) of the log; NaN where there was no picture."""
        found = np.full(len(rows), np.nan)
        if len(self.row):
            order = np.argsort(self.row, kind="stable")
            places = np.minimum(np.searchsorted(self.row[order], rows), len(order) - 1)
            is_there = self.row[order][places] == rows
            found[is_there] = self.steering[order][places[is_there]]
        return found


@dataclass
class Predicting:
    """A prediction that was requested."""

    total: int  # pictures
    pictures: int = 0
    is_begun: bool = False  # else it waits until the one before it has ended
    is_done: bool = False
    is_stopped: bool = False
    problem: str = ""
    left_s: float | None = None
    """Remaining time; None while it is unknown."""
    _first: tuple[int, float] | None = None  # pictures by the first report, and when: before lies the beginning

    def advance_to(self, pictures: int) -> None:
        self.pictures = min(self.total, pictures)
        now_s = time.monotonic()
        if self._first is None:
            self._first = self.pictures, now_s
        elif self.pictures > self._first[0]:
            each_s = (now_s - self._first[1]) / (self.pictures - self._first[0])
            self.left_s = each_s * (self.total - self.pictures)


class Predictions:
    """Predictions that are kept, and those that are being made. The folder may be deleted at any time."""

    def __init__(self, cache: Path) -> None:
        self._folder = cache / "predictions"
        self._pool = ThreadPoolExecutor(1, "predicting")
        self._lock = threading.Lock()
        self._requested: dict[str, Predicting] = {}
        self._fingerprints: dict[Path, tuple[str, str]] = {}
        self._process: subprocess.Popen[bytes] | None = None
        self._at_work: Predicting | None = None  # what that process is for
        self._is_closed = False

    def key(self, log_fingerprint: str, run: Path) -> str:
        """The name that this prediction has here. Raises WebError for a run without weights."""
        files = [run / WEIGHTS, run / CONFIG]
        version = version_of(*files)
        known = self._fingerprints.get(run)
        if known is None or known[0] != version:
            digest = hashlib.sha256()
            try:
                for file in files:
                    with file.open("rb") as stream:
                        digest.update(hashlib.file_digest(stream, "sha256").digest())
            except OSError as error:
                why = f"{error.filename}: {error.strerror}"
                raise WebError(f"{why}; a run has weights after its first epoch", 409) from None
            self._fingerprints[run] = known = version, digest.hexdigest()
        return hashlib.sha256(f"{_FORMAT} {log_fingerprint} {known[1]}".encode()).hexdigest()

    def find(self, key: str) -> Predicted | None:
        """The prediction of that key; None where it was not made yet, or is kept no more."""
        path = self._path(key)
        try:
            with np.load(path, allow_pickle=False) as kept:
                about = msgspec.json.decode(kept["about"].tobytes(), type=Measured)
                return Predicted(about, kept["row"].astype(np.int64), kept["predicted"].astype(np.float64))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, EOFError, msgspec.MsgspecError):  # damaged: it is made again
            with contextlib.suppress(OSError):
                path.unlink()
            return None

    def predicting(self, key: str) -> Predicting | None:
        with self._lock:
            return self._requested.get(key)

    def start(self, key: str, log: Location, log_fingerprint: str, run: Path, pictures: int) -> None:
        """Begin with it, if it is not under way."""
        with self._lock:
            known = self._requested.get(key)
            if known is not None and not (known.is_done or known.is_stopped):
                return
            self._requested[key] = predicting = Predicting(pictures)
        words = [as_word(log), str(run.absolute()), log_fingerprint, str(self._path(key).absolute())]
        self._pool.submit(self._run, predicting, words)

    def stop(self, key: str) -> None:
        """End it, for all pages that wait for it; one that has ended stays as it is."""
        with self._lock:
            predicting = self._requested.get(key)
            if predicting is None or predicting.is_done:
                return
            predicting.is_stopped = True
            predicting.problem = predicting.problem or STOPPED
            if self._at_work is predicting and self._process is not None:
                self._process.kill()

    def close(self) -> None:
        self._is_closed = True
        with self._lock:
            if self._process is not None:
                self._process.kill()
        self._pool.shutdown(cancel_futures=True)

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}.npz"

    def _run(self, predicting: Predicting, words: list[str]) -> None:
        leave_signals_to_main_thread()
        try:
            # of its own: a process that is killed leaves its copy of a log in a store behind
            with tempfile.TemporaryDirectory(prefix="bc-web-", ignore_cleanup_errors=True) as temporary:
                self._run_in(temporary, predicting, words)
        except OSError as error:
            predicting.problem = f"it cannot be started: {error.strerror}"
        finally:
            with self._lock:
                self._process = self._at_work = None
            predicting.is_done = True

    def _run_in(self, temporary: str, predicting: Predicting, words: list[str]) -> None:
        with self._lock:
            if self._is_closed or predicting.is_stopped:
                return
            predicting.is_begun = True
            self._at_work = predicting
            self._process = process = subprocess.Popen(
                own_process("web.data.prediction_process", *words),
                stdin=subprocess.PIPE,  # it ends with this process
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONUNBUFFERED": "1", "TMPDIR": temporary},
                start_new_session=True,
            )
        with process:
            assert process.stdout is not None  # noqa: S101
            for line in process.stdout:
                _update(predicting, line)
        if process.returncode and not predicting.problem:
            predicting.problem = f"the process that predicts ended with {process.returncode}; try it again"


def _update(predicting: Predicting, line: bytes) -> None:
    with contextlib.suppress(ValueError):
        message = json.loads(line)
        if "problem" in message:
            predicting.problem = printable(str(message["problem"]))
        else:
            predicting.advance_to(int(message["pictures"]))
