"""Errors of predicted steering and of other targets, compared with those of constant predictions.

Half to four fifths of recorded labels are near zero, so a small mean error alone means little. Every measure is
compared with always predicting zero, and with always predicting the mean.

A network answers a picture at once, a person after a reaction time. Therefore the answers of a good network
correlate better with the steering recorded a little later than with that of the same moment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from common.errors import decimal
from common.steering_unit import SteeringUnit, assumed_deg, steering_unit
from dataset import MAX_STEERING_DEG
from dataset.prediction_targets import TARGETS, TargetName
from dataset.steering_bins import BINS, bin_of

if TYPE_CHECKING:
    import pyarrow as pa

TURNING = 0.05  # |steering| above this is turning

Floats = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True)
class Errors:
    """Errors in degrees of wheel angle, by `assumed_deg`; NaN if there are no frames to measure."""

    mae_deg: float
    rmse_deg: float
    turning_mae_deg: float
    correlation: float  # -1..1; NaN if the predictions or the labels are constant


@dataclass(frozen=True)
class BinErrors:
    """The errors in one bin of the recorded steering that has frames."""

    bin: int
    low: float  # edges of the bin, -1..1
    high: float
    frames: int
    mae_deg: float
    rmse_deg: float
    bias_deg: float  # mean of predicted - recorded: positive is too far to the right


@dataclass(frozen=True)
class Measures:
    frames: int
    network: Errors
    zero: Errors  # of always predicting 0 on the same frames
    mean: Errors  # of always predicting the mean of these frames: no constant has a smaller RMSE
    bins: tuple[BinErrors, ...]
    mean_balanced_rmse_deg: float = math.nan  # of always predicting the mean; NaN if unknown
    max_deg: float | None = MAX_STEERING_DEG  # the wheels' angle at steering 1; None: unknown

    @property
    def unit(self) -> SteeringUnit:
        return steering_unit(self.max_deg)

    @property
    def balanced_rmse_deg(self) -> float:
        """The root of the mean over bins of their mean squared errors: every bin counts alike, as in training.

        On a mostly straight road, a network that always goes straight has a small RMSE, but a large balanced RMSE.
        """
        return _balanced_rmse_deg(self.bins)

    @property
    def driving_error(self) -> float:
        """The balanced RMSE divided by that of always predicting the mean, plus 1 - correlation. 0 is best; always
        predicting the mean has 2. It predicts best how often a network leaves the road
        (docs/studies/which-number.md)."""
        correlation = 0.0 if math.isnan(self.network.correlation) else self.network.correlation
        mean_rmse_deg = self.mean_balanced_rmse_deg or 1.0  # 0 if the steering is constant
        return self.balanced_rmse_deg / mean_rmse_deg + 1 - correlation


def measure(
    predicted: Floats, recorded: Floats, bins: int = BINS, *, max_deg: float | None = MAX_STEERING_DEG
) -> Measures:
    """Compare two steering arrays (N,), -1..1, as a whole and within `bins` equal bins of the recorded steering.
    `max_deg` is the wheels' angle at steering 1, None if unknown."""
    mean = float("nan")
    if len(recorded):  # rounding moves the mean of equal numbers away from them
        mean = float(np.clip(np.mean(recorded), np.min(recorded), np.max(recorded)))
    return Measures(
        len(recorded),
        errors(predicted, recorded, max_deg),
        constant_errors(0.0, recorded, max_deg),
        constant_errors(mean, recorded, max_deg),
        tuple(_bin_errors(predicted, recorded, bins, max_deg)),
        _balanced_rmse_deg(_bin_errors(np.full(len(recorded), mean), recorded, bins, max_deg)),
        max_deg,
    )


def errors(predicted: Floats, recorded: Floats, max_deg: float | None = MAX_STEERING_DEG) -> Errors:
    """Compare two steering arrays (N,), -1..1."""
    nan = float("nan")
    if not len(recorded):
        return Errors(nan, nan, nan, nan)
    off = _off_deg(predicted, recorded, max_deg)
    turning = is_turning(recorded)
    varies = predicted.min() < predicted.max() and recorded.min() < recorded.max()
    return Errors(
        mae_deg=float(np.abs(off).mean()),
        rmse_deg=float(np.sqrt(np.square(off).mean())),
        turning_mae_deg=float(np.abs(off[turning]).mean()) if turning.any() else nan,
        correlation=float(np.corrcoef(predicted, recorded)[0, 1]) if varies else nan,
    )


def is_turning(recorded: Floats) -> NDArray[np.bool_]:
    """True where the recorded steering (N,) turns."""
    return np.abs(_exact(recorded)) > TURNING


def constant_errors(value: float, recorded: Floats, max_deg: float | None = MAX_STEERING_DEG) -> Errors:
    """The errors of always predicting `value`."""
    return errors(np.full(len(recorded), value), recorded, max_deg)


def _balanced_rmse_deg(bins: Sequence[BinErrors]) -> float:
    return math.sqrt(sum(part.rmse_deg**2 for part in bins) / len(bins)) if bins else math.nan


def _off_deg(predicted: Floats, recorded: Floats, max_deg: float | None) -> NDArray[np.float64]:
    return assumed_deg(max_deg) * (predicted.astype(np.float64) - recorded.astype(np.float64))


def _exact(recorded: Floats) -> NDArray[np.float64]:
    """In float32, a value on an edge may lie next to it."""
    exact: NDArray[np.float64] = recorded.astype(np.float64)
    return np.round(exact, 6)


def _bin_errors(predicted: Floats, recorded: Floats, bins: int, max_deg: float | None) -> list[BinErrors]:
    off = _off_deg(predicted, recorded, max_deg)
    bin_index = bin_of(_exact(recorded), bins)
    errors_of_bins = []
    for number in np.unique(bin_index).tolist():
        part = off[bin_index == number]
        errors_of_bins.append(
            BinErrors(
                number,
                -1 + 2 * number / bins,
                -1 + 2 * (number + 1) / bins,
                len(part),
                float(np.abs(part).mean()),
                float(np.sqrt(np.square(part).mean())),
                float(part.mean()),
            )
        )
    return errors_of_bins


@dataclass(frozen=True)
class TargetErrors:
    """The errors of a target on the frames with a label, in the unit of the target; NaN if no frame has a
    label."""

    target: TargetName
    frames: int
    mae: float
    rmse: float
    bias: float  # mean of predicted - recorded
    correlation: float  # -1..1; NaN if the predictions or the labels are constant
    mean_rmse: float  # of always predicting the mean of these frames: no constant has a smaller RMSE

    def as_dict(self) -> dict[str, Any]:
        """For JSON, with the unit."""
        return {**asdict(self), "unit": TARGETS[self.target].unit}

    def __str__(self) -> str:
        """ "speed: RMSE 1.42 mph (always the mean: 4.10), correlation 0.93"."""
        unit = f" {TARGETS[self.target].unit}".rstrip()
        return (
            f"{self.target}: RMSE {self.rmse:.2f}{unit} (always the mean: {self.mean_rmse:.2f}),"
            f" correlation {decimal(self.correlation, 2)}"
        )


def target_errors(target: TargetName, predicted: Floats, recorded: Floats) -> TargetErrors:
    """Compare two arrays (N,) in the target's unit; NaN in `recorded` means unknown."""
    is_known = np.isfinite(recorded)
    predicted, recorded = predicted[is_known], recorded[is_known]
    nan = math.nan
    if not len(recorded):
        return TargetErrors(target, 0, nan, nan, nan, nan, nan)
    off = predicted - recorded
    varies = predicted.min() < predicted.max() and recorded.min() < recorded.max()
    return TargetErrors(
        target,
        len(recorded),
        float(np.abs(off).mean()),
        float(np.sqrt(np.square(off).mean())),
        float(off.mean()),
        float(np.corrcoef(predicted, recorded)[0, 1]) if varies else nan,
        float(np.std(recorded)),
    )


def other_targets(targets: Sequence[TargetName], predicted: Floats, recorded: Floats) -> tuple[TargetErrors, ...]:
    """The errors of all targets except steering. Labels and answers have the units of
    `dataset.prediction_targets`."""
    if len(targets) == 1:
        return ()
    return tuple(
        target_errors(name, predicted[:, at] * TARGETS[name].per_unit, recorded[:, at] * TARGETS[name].per_unit)
        for at, name in enumerate(targets)
        if at
    )


DELAYS_S: Final = tuple(round(0.05 * step, 2) for step in range(13))
"""Up to 0.6 s: published recordings of people have their maximum at 0.1 to 0.3 s."""

MIN_KNOWN: Final = 0.5
"""The share of frames whose later steering must be known."""

_PAUSE_NS: Final = 1_000_000_000
"""A longer step between frames is a pause."""


@dataclass(frozen=True)
class ReactionTime:
    """The delay that most raises the correlation between a network's answers and the recorded steering."""

    delay_s: float  # mean over frames
    correlation: float  # -1..1, at this delay
    at_once: float  # the correlation of the same frames without a delay


def reaction_time(frames: pa.Table) -> ReactionTime | None:
    """The reaction time in the frames of an evaluation (columns session, log_time_ns, recorded, predicted).

    None if the answers or the steering are constant, or if the correlation still grows at the largest delay.
    """
    from dataset.frames.distinct_rows import by_session  # Arrow

    sessions = [part.sort_by("log_time_ns") for _, part in by_session(frames)]
    predicted, recorded = (
        np.concatenate([part[name].to_numpy() for part in sessions]) for name in ("predicted", "recorded")
    )
    delays = []
    for delay_s in DELAYS_S:
        later, after_s = np.concatenate([_steering_later(part, delay_s) for part in sessions], axis=1)
        is_known = np.isfinite(later)
        if is_known.mean() < MIN_KNOWN:
            break
        if delay_s and not after_s[is_known].any():
            continue  # shorter than half a step: fewer frames than at 0, but none later
        # the last frames before a pause have no later steering: `at_once` leaves them out, too
        correlation, at_once = (
            errors(predicted[is_known], steering[is_known]).correlation for steering in (later, recorded)
        )
        delays.append(ReactionTime(float(after_s[is_known].mean()), correlation, at_once))
    defined = [delay for delay in delays if not math.isnan(delay.correlation - delay.at_once)]
    best = max(defined, key=lambda delay: delay.correlation - delay.at_once, default=None)
    return None if best is not None and 0 < best.delay_s == defined[-1].delay_s else best


def _steering_later(frames: pa.Table, delay_s: float) -> NDArray[np.float64]:
    """For each frame of a session, the steering of the frame nearest to `delay_s` seconds later, and that frame's
    delay in s: (2, N). NaN beyond the next pause.

    It is not interpolated between frames: at delays other than 0, it would have less noise than at 0.
    """
    time_ns, recorded = frames["log_time_ns"].to_numpy(), frames["recorded"].to_numpy()
    later_ns = time_ns + round(delay_s * 1e9)
    nearest = np.searchsorted(time_ns[:-1] + np.diff(time_ns) // 2, later_ns)
    last_ns = np.append(time_ns[:-1][np.diff(time_ns) > _PAUSE_NS], time_ns[-1])  # of each drive
    is_known = later_ns <= last_ns[np.searchsorted(last_ns, time_ns)]
    return np.where(is_known, [recorded[nearest], (time_ns[nearest] - time_ns) / 1e9], np.nan)
