"""The differences between two networks, measure by measure, with confidence intervals.

B is worse than A if the whole confidence interval of any measure's difference is worse than the tolerance. All
intervals together hold with 95 % confidence (Bonferroni). So with any number of measures, about one of forty
comparisons of equally good networks calls B worse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from model.evaluation.block_bootstrap import Floats, Statistic, intervals
from model.runs.run_files import without_nan

CONFIDENCE: Final = 0.95  # that the intervals of all measures hold together
BLOCK_S: Final = 5.0  # measured: errors are uncorrelated after 2 to 5 s
FEWEST_BLOCKS: Final = 6  # fewer give no reliable interval

Verdict = Literal["worse", "better", "not told apart", "unknown"]


@dataclass(frozen=True)
class Measure:
    name: str  # in JSON
    heading: str
    is_error: bool = True  # smaller is better
    scale: float | None = None  # the tolerance is a share of this value; None: of A's measure


MEASURES: Final = (
    Measure("rmse_deg", "RMSE"),
    Measure("turning_mae_deg", "MAE on turns"),
    Measure("balanced_rmse_deg", "balanced RMSE"),
    Measure("correlation", "correlation", is_error=False, scale=1.0),
)
"""The measures of `model.metrics` that a comparison judges."""


@dataclass(frozen=True)
class Difference:
    """One measure of A and B, and the confidence interval of B - A. NaN where a value is missing."""

    measure: Measure
    a: float
    b: float
    low: float
    high: float
    allowed: float  # the tolerance: B may be worse by this much

    @property
    def verdict(self) -> Verdict:
        """Better if the whole interval is on the better side; worse if it is on the worse side, beyond the
        tolerance."""
        best, worst = (self.low, self.high) if self.measure.is_error else (-self.high, -self.low)
        if math.isnan(best) or math.isnan(worst):
            return "unknown"
        if best > self.allowed:
            return "worse"
        return "better" if worst < 0 else "not told apart"

    def as_dict(self) -> dict[str, Any]:
        """For JSON; None where a value is missing."""
        numbers = {"a": self.a, "b": self.b, "difference": self.b - self.a, "low": self.low, "high": self.high}
        stored: dict[str, Any] = without_nan({**numbers, "allowed": self.allowed})
        return {**stored, "verdict": self.verdict}


def compare_sums(
    a: Floats, b: Floats, measures: Sequence[Measure], statistic: Statistic, tolerance: float
) -> tuple[Difference, ...]:
    """The difference in each measure, from the sums of the blocks of A and of B: (blocks, K) each, in the same
    order. `statistic` computes the measures from sums. With fewer than `FEWEST_BLOCKS`, intervals are NaN, unless
    A and B are equal.
    """
    measured_a, measured_b = statistic(a.sum(axis=0)), statistic(b.sum(axis=0))
    low = high = np.full(len(measures), math.nan)
    if np.array_equal(a, b):  # with any number of blocks: equal answers differ by exactly 0
        low = high = measured_b - measured_a
    elif len(a) >= FEWEST_BLOCKS:
        split = a.shape[1]
        low, high = intervals(
            np.hstack([a, b]),
            lambda sums: statistic(sums[..., split:]) - statistic(sums[..., :split]),
            1 - (1 - CONFIDENCE) / len(measures),
        )
    values = np.stack([measured_a, measured_b, low, high], axis=1).tolist()
    return tuple(
        Difference(
            measure,
            value_a,
            value_b,
            low,
            high,
            tolerance * (abs(value_a) if measure.scale is None else measure.scale),
        )
        for measure, (value_a, value_b, low, high) in zip(measures, values, strict=True)
    )


def overall(differences: Sequence[Difference]) -> Verdict:
    """Worse if any measure is worse; else better if any is better; unknown if no measure has an interval."""
    verdicts = {difference.verdict for difference in differences}
    ranked: tuple[Verdict, ...] = ("worse", "better", "not told apart")
    return next((verdict for verdict in ranked if verdict in verdicts), "unknown")
