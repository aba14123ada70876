"""The differences between two networks, measure by measure, with confidence intervals.

B is worse than A if the whole confidence interval of any measure's difference is worse than the tolerance. All
intervals together hold with 95 % confidence (Bonferroni). So with any number of measures, about one of forty
comparisons of equally good networks calls B worse.

The intervals are of a paired block bootstrap. Neighbouring frames show the same stretch of road, so their errors
are alike. As independent frames, they would give far too narrow intervals. So whole blocks are drawn, with
replacement (Carlstein 1986, "The use of subseries values"; Künsch 1989, "The jackknife and the bootstrap for
general stationary observations"). Both networks are measured on the same draw, so the difficulty of a block
cancels out.

A measure such as the RMSE is a function of sums over frames. Each block is a row of sums, and a draw adds up rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from model.runs.run_files import without_nan

Floats = NDArray[np.float64]

Statistic = Callable[[Floats], Floats]
"""Measures (..., M) of sums (..., K): K sums on the last axis."""

DRAWS: Final = 4000
_CHUNK: Final = 1 << 22  # draws x blocks computed at once: 32 MB
_NORMAL: Final = NormalDist()


def intervals(sums: Floats, statistic: Statistic, confidence: float, draws: int = DRAWS) -> tuple[Floats, Floats]:
    """The lower and upper ends (M,) of the confidence intervals of `statistic`, from the sums of at least two
    blocks (blocks, K). NaN for a measure that is not finite in any draw. Equal sums give equal intervals.
    """
    generator = np.random.default_rng(0)
    blocks = len(sums)
    chunk = max(1, _CHUNK // blocks)
    sizes = [min(chunk, draws - first) for first in range(0, draws, chunk)]
    shares = np.full(blocks, 1 / blocks)
    drawn = np.concatenate([statistic(generator.multinomial(blocks, shares, size=size) @ sums) for size in sizes])
    tail = _tail(blocks, confidence)
    low, high = np.full(drawn.shape[1], np.nan), np.full(drawn.shape[1], np.nan)
    for measure, values in enumerate(drawn.T):
        if len(finite := values[np.isfinite(values)]):
            low[measure], high[measure] = np.quantile(finite, [tail, 1 - tail])
    return low, high


def _tail(blocks: int, confidence: float) -> float:
    """The share of draws beyond each end of the interval: less than (1 - confidence) / 2.

    With n blocks, intervals between plain percentiles are too narrow, by the factor sqrt((n - 1) / n) and by the
    ratio of Student's t to the normal distribution. These are the expanded percentiles of Hesterberg 2015, "What
    Teachers Should Know About the Bootstrap", section 5.2.
    """
    quantile = _student_quantile(1 - (1 - confidence) / 2, blocks - 1)
    return _NORMAL.cdf(-math.sqrt(blocks / (blocks - 1)) * quantile)


def _student_quantile(probability: float, freedom: int) -> float:
    """The quantile of Student's t with `freedom` degrees of freedom: Abramowitz and Stegun 1964, 26.7.5."""
    z = _NORMAL.inv_cdf(probability)
    return (
        z
        + (z**3 + z) / (4 * freedom)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)
    )


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
