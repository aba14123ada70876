"""Two runs compared on the same recorded frames.

bc-eval compare A B
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from common.steering_unit import assumed_deg
from dataset import MAX_STEERING_DEG
from dataset.frames.split import block_numbers
from dataset.prediction_targets import TARGETS, TargetName
from dataset.steering_bins import BINS, bin_of
from model.evaluation.differences import (
    BLOCK_S,
    CONFIDENCE,
    MEASURES,
    Difference,
    Floats,
    Measure,
    compare_sums,
    overall,
)
from model.evaluation.evaluate import Evaluation, target_columns
from model.metrics import is_turning
from model.runs.run_folder import run_name

MANY_SESSIONS: Final = 10  # from this number on, whole sessions are drawn: they differ more than blocks do


@dataclass(frozen=True)
class Comparison:
    """Predictions of two runs for the same frames, and the differences of their errors."""

    a: Evaluation
    b: Evaluation
    tolerance: float = 0.0

    @cached_property
    def unit(self) -> NDArray[np.int64]:
        """The number of each frame's block, or of its session if there are many: from 0, (frames,)."""
        session = self.a.frames["session"].combine_chunks().dictionary_encode()
        number: NDArray[np.int64] = session.indices.to_numpy().astype(np.int64)
        if self.units == "sessions":
            return number
        return blocks_of(number, self.a.frames["log_time_ns"].to_numpy())

    @property
    def units(self) -> str:
        """The unit that is drawn and counted: blocks or sessions."""
        return "sessions" if len(self.a.sessions) >= MANY_SESSIONS else "blocks"

    @property
    def unit_count(self) -> int:
        return int(self.unit.max()) + 1

    @cached_property
    def answers_apart_deg(self) -> float:
        """The root mean square of B's answers minus A's, in degrees: 0 for the same network."""
        a, b = (run.frames["predicted"].to_numpy() for run in (self.a, self.b))
        return assumed_deg(self.a.max_deg) * float(np.sqrt(np.square(b - a).mean()))

    @cached_property
    def differences(self) -> tuple[Difference, ...]:
        targets = [name for name in self.a.targets[1:] if name in self.b.targets]
        measures = (*MEASURES, *map(_rmse_of, targets))
        a, b = (
            np.hstack(
                [
                    sums_of_blocks(run.frames, self.unit, run.max_deg),
                    *_sums_of_targets(run.frames, self.unit, targets),
                ]
            )
            for run in (self.a, self.b)
        )
        return compare_sums(a, b, measures, measures_of_sums, self.tolerance)

    def as_dict(self) -> dict[str, Any]:
        return {
            "a": run_name(self.a.run),
            "b": run_name(self.b.run),
            "learnt": {"a": self.a.trained_on, "b": self.b.trained_on},
            "skipped": dict(self.a.skipped.counts),
            "frames": len(self.unit),
            self.units: self.unit_count,
            "confidence": CONFIDENCE,
            "tolerance": self.tolerance,
            "answers_apart_deg": self.answers_apart_deg,
            **({"max_deg": None} if self.a.max_deg is None else {}),
            "measures": {difference.measure.name: difference.as_dict() for difference in self.differences},
            "verdict": overall(self.differences),
        }


def blocks_of(session: NDArray[np.int64], time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number of each frame's block of `BLOCK_S`, from 0. Both arguments are (frames,), in the order of the
    recording. A block ends with its session, at a gap of half a block, and where the clock was set back."""
    step_ns = np.diff(time_ns)
    is_apart = (np.diff(session) != 0) | (step_ns < 0) | (step_ns > BLOCK_S / 2 * 1e9)
    return block_numbers(time_ns, np.concatenate([[0], np.cumsum(is_apart)]), BLOCK_S)


def sums_of_blocks(frames: pa.Table, unit: NDArray[np.int64], max_deg: float | None = MAX_STEERING_DEG) -> Floats:
    """The sums of each block, (blocks, K), for `measures_of_sums`. `max_deg` is the wheels' angle at steering
    1."""
    predicted, recorded = (frames[name].to_numpy() for name in ("predicted", "recorded"))
    off_deg = assumed_deg(max_deg) * (predicted - recorded)
    turning = is_turning(recorded)
    in_bin = bin_of(np.round(recorded, 6), BINS)[:, None] == np.arange(BINS)  # rounded as in model.metrics
    per_frame = np.column_stack(
        [
            np.ones(len(recorded)),
            np.square(off_deg),
            turning,
            np.abs(off_deg) * turning,
            predicted,
            recorded,
            np.square(predicted),
            np.square(recorded),
            predicted * recorded,
            in_bin,
            in_bin * np.square(off_deg)[:, None],
        ]
    )
    return _summed(per_frame, unit)


def _sums_of_targets(frames: pa.Table, unit: NDArray[np.int64], targets: Sequence[TargetName]) -> Iterator[Floats]:
    """For each target, the sums of each block (blocks, 2): the frames with a label, and their squared errors."""
    for target in targets:
        predicted, recorded = (frames[column].to_numpy() for column in target_columns(target))
        off = predicted - recorded
        is_known = np.isfinite(off)
        yield _summed(np.column_stack([is_known, np.square(np.where(is_known, off, 0.0))]), unit)


def _rmse_of(target: TargetName) -> Measure:
    about = TARGETS[target]
    return Measure(f"{about.answer_name}_rmse", f"RMSE of {target}{f' ({about.unit})' if about.unit else ''}")


def _summed(per_frame: Floats, unit: NDArray[np.int64]) -> Floats:
    """The sums over the frames of each block: (frames, K) to (blocks, K)."""
    sums = np.zeros((int(unit.max()) + 1, per_frame.shape[1]))
    np.add.at(sums, unit, per_frame)
    return sums


def measures_of_sums(sums: Floats) -> Floats:
    """`MEASURES`, and the RMSE of each further target, from sums of blocks: (..., K) to (..., 4 or more). NaN
    where a measure has no frames.

    Constant answers have the correlation 0, which is worse than that of any network that follows the road.
    Constant recorded steering has NaN.
    """
    count, squares, turns, turn_errors, p, r, pp, rr, pr = np.moveaxis(sums[..., :9], -1, 0)
    in_bin, bin_squares = sums[..., 9 : 9 + BINS], sums[..., 9 + BINS : 9 + 2 * BINS]
    target_sums = sums[..., 9 + 2 * BINS :]
    with np.errstate(divide="ignore", invalid="ignore"):
        bin_means = np.where(in_bin > 0, bin_squares / in_bin, 0.0)
        covariance, variance_p, variance_r = pr - p * r / count, pp - p * p / count, rr - r * r / count
        correlation = covariance / np.sqrt(variance_p * variance_r)
        rounding = 1e-12 * count  # rounding error of a sum of squares up to 1
        correlation = np.where(variance_p > rounding, correlation, 0.0)
        correlation = np.where(variance_r > rounding, correlation, np.nan)
        return np.stack(
            [
                np.sqrt(squares / count),
                turn_errors / turns,
                np.sqrt(bin_means.sum(axis=-1) / (in_bin > 0).sum(axis=-1)),
                correlation,
                *np.moveaxis(np.sqrt(target_sums[..., 1::2] / target_sums[..., ::2]), -1, 0),
            ],
            axis=-1,
        )
