"""The steering that a run predicts for a log. The cache keeps it by the fingerprints of both."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from common.location import Location
from web.folders.project_folders import as_word
from web.logs.drive_course import at_rows
from web.processes.kept_work import KeptWork, run_fingerprint

_FORMAT: Final = 1  # of the kept files


class WorstMoment(msgspec.Struct, frozen=True):
    """A moment with one of the largest errors; `error_deg` is positive if the network steers too far right."""

    row: int
    error_deg: float
    predicted_deg: float
    recorded_deg: float


class Measured(msgspec.Struct, frozen=True):
    """The errors of a network. RMSEs are None if the log has no steering to compare with."""

    frames: int
    rmse_deg: float | None
    mean_rmse_deg: float | None  # of always predicting the mean
    max_deg: float | None  # the wheels' angle at steering 1; None: unknown
    worst: list[WorstMoment]
    notes: list[str]  # skipped pictures and messages


@dataclass(frozen=True)
class Predicted:
    about: Measured
    row: NDArray[np.int64]  # (N,), one for each picture of the centre camera that decodes
    steering: NDArray[np.float64]  # (N,), -1 (left) to 1 (right), before any clamp

    def at(self, rows: NDArray[np.int64]) -> NDArray[np.float64]:
        """The steering at rows (M,) of the log; NaN for a row without a picture."""
        return at_rows(self.row, self.steering, rows)


class Predictions:
    """The predictions that are kept, running and waiting."""

    def __init__(self, cache: Path) -> None:
        stopped = "stopped; choose the run again to start anew"
        self.work = KeptWork(cache / "predictions", "web.processes.prediction_process", stopped)

    def key(self, log_fingerprint: str, run: Path) -> str:
        """The key of a prediction. Raises WebError for a run without weights."""
        return hashlib.sha256(f"{_FORMAT} {log_fingerprint} {run_fingerprint(run)}".encode()).hexdigest()

    def find(self, key: str) -> Predicted | None:
        """The prediction of a key; None if it is not kept."""
        return self.work.find(key, _predicted)

    def start(self, key: str, log: Location, log_fingerprint: str, run: Path, pictures: int) -> None:
        """Start it, unless it is waiting or running."""
        self.work.start(key, pictures, [as_word(log), str(run.absolute()), log_fingerprint])


def _predicted(kept: Mapping[str, NDArray[Any]]) -> Predicted:
    about = msgspec.json.decode(kept["about"].tobytes(), type=Measured)
    return Predicted(about, kept["row"].astype(np.int64), kept["predicted"].astype(np.float64))
