"""The steering that a run predicts for a log. The cache keeps it by the fingerprints of both.

A process of this module predicts, because a network uses all processors for a while and would delay the pages. It
runs no user's own network code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from common.errors import printable
from web.errors import WebError
from web.processes.kept_work import KeptWork, counter, run_fingerprint, run_in_process, write_result

Values = NDArray[np.float64]

_FORMAT: Final = 1  # of the kept files
_WORST: Final = 30  # moments in the list
_NICENESS: Final = 5


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
    steering: Values  # (N,), -1 (left) to 1 (right), before any clamp

    def at(self, rows: NDArray[np.int64]) -> Values:
        """The steering at rows (M,) of the log; NaN for a row without a picture."""
        return at_rows(self.row, self.steering, rows)


def at_rows(row: NDArray[np.int64], values: Values, rows: NDArray[np.int64]) -> Values:
    """The values (..., M) with these row numbers (M,) at `rows` (N,): (..., N); NaN for rows without a value."""
    if not len(row):
        return np.full((*values.shape[:-1], len(rows)), np.nan)
    order = np.argsort(row, kind="stable")
    place = np.minimum(np.searchsorted(row[order], rows), len(order) - 1)
    return np.where(row[order][place] == rows, values[..., order[place]], np.nan)


class Predictions:
    def __init__(self, cache: Path) -> None:
        stopped = "stopped; choose the run again to start anew"
        self.work = KeptWork(cache / "predictions", "web.processes.predictions", stopped)

    def key(self, log_fingerprint: str, run: Path) -> str:
        """The key of a prediction. Raises WebError for a run without weights."""
        return hashlib.sha256(f"{_FORMAT} {log_fingerprint} {run_fingerprint(run)}".encode()).hexdigest()

    def find(self, key: str) -> Predicted | None:
        return self.work.find(key, _predicted)

    def start(self, key: str, log: Path, log_fingerprint: str, run: Path, pictures: int) -> None:
        self.work.start(key, pictures, [str(log.absolute()), str(run.absolute()), log_fingerprint])


def _predicted(kept: Mapping[str, NDArray[Any]]) -> Predicted:
    about = msgspec.json.decode(kept["about"].tobytes(), type=Measured)
    return Predicted(about, kept["row"].astype(np.int64), kept["predicted"].astype(np.float64))


def main() -> None:
    run_in_process(_work, _NICENESS)


def _work(log: str, run: str, fingerprint: str, result: str) -> None:
    from model.evaluation.predict import BATCH  # these load PyTorch
    from model.evaluation.predict_log import predict_log
    from model.metrics import measure

    predictions = predict_log(Path(log), [Path(run)], on_batch=counter(BATCH))
    if predictions.about["log_fingerprint"] != fingerprint:
        raise WebError("the log has been replaced since this page was opened: reload it")
    [(name, predicted)] = predictions.predicted.items()
    is_recorded = np.isfinite(predictions.recorded)
    measured = measure(predicted[is_recorded], predictions.recorded[is_recorded], max_deg=predictions.max_deg)
    about = Measured(
        frames=measured.frames,
        rmse_deg=measured.network.rmse_deg if measured.frames else None,
        mean_rmse_deg=measured.mean.rmse_deg if measured.frames else None,
        max_deg=predictions.max_deg,
        worst=[
            WorstMoment(worst.row, worst.error_deg, worst.predicted_deg, worst.recorded_deg)
            for worst in predictions.worst(name, _WORST)
        ],
        notes=[printable(line) for line in (*predictions.skipped.lines(), predictions.notice) if line],
    )
    encoded = np.frombuffer(msgspec.json.encode(about), np.uint8)
    write_result(Path(result), row=predictions.row, predicted=predicted, about=encoded)
