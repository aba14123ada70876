"""Predictions of networks for a recorded log, their errors, and the moments of the largest errors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common import Skipped
from common.errors import counted
from common.steering_unit import SteeringUnit, assumed_deg, steering_unit
from dataset import MAX_STEERING_DEG
from model.metrics import measure
from model.runs.worst_pictures import WorstFrame, worst_frames

Values = NDArray[np.float64]

WORST_MOMENTS: Final = 10  # of each run; they become events


@dataclass(frozen=True)
class LogPredictions:
    """Predictions of networks for the pictures of a log, in the order of the log. Steering is -1 (left) .. 1
    (right)."""

    session: str
    row: NDArray[np.int64]  # of each picture
    log_time_ns: NDArray[np.int64]
    recorded: Values  # NaN where no steering was recorded with the picture
    predicted: dict[str, Values]  # by the name of the run, not clamped
    about: dict[str, str] = field(default_factory=dict)  # metadata of the log and the weights
    skipped: Skipped = field(default_factory=Skipped)  # pictures that do not decode
    notice: str = ""  # if the log was never finished
    max_deg: float | None = MAX_STEERING_DEG  # the wheels' angle at steering 1; None: unknown

    @property
    def unit(self) -> SteeringUnit:
        return steering_unit(self.max_deg)

    def error_deg(self, run: str) -> Values:
        """Predicted - recorded, in degrees: positive is too far to the right; NaN where no steering was
        recorded."""
        return assumed_deg(self.max_deg) * (self.predicted[run] - self.recorded)

    def worst(self, run: str, count: int = WORST_MOMENTS) -> list[WorstFrame]:
        """The moments with the largest errors of a run: see `worst_frames`."""
        is_recorded = np.isfinite(self.recorded)
        frames = {
            "session": pa.array([self.session] * int(is_recorded.sum()), pa.string()),
            "row": self.row[is_recorded],
            "log_time_ns": self.log_time_ns[is_recorded],
            "recorded": self.recorded[is_recorded],
            "predicted": self.predicted[run][is_recorded],
        }
        return worst_frames(pa.table(frames), count, self.max_deg)

    def summary(self, run: str) -> str:
        is_recorded = np.isfinite(self.recorded)
        if not is_recorded.any():
            return f"{run}: {counted(len(self.row), 'frame')}, no steering recorded with them to compare with"
        measures = measure(self.predicted[run][is_recorded], self.recorded[is_recorded], max_deg=self.max_deg)
        unit = measures.unit
        return (
            f"{run}: {counted(measures.frames, 'frame')}, RMSE {unit.of(measures.network.rmse_deg):.2f}"
            f" {unit.name} from the recorded steering (always the mean: {unit.of(measures.mean.rmse_deg):.2f}),"
            f" MAE {unit.of(measures.network.mae_deg):.2f}"
        )

    def worst_moments(self, run: str) -> list[tuple[int, str]]:
        """Log time in ns and description of the worst moments of a run, the earliest first."""
        worst = self.worst(run)
        return sorted((at.log_time_ns, f"{run}: {at.in_words(self.unit)} (row {at.row})") for at in worst)
