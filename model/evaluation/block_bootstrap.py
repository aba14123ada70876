"""Confidence intervals of measures over frames that depend on their neighbours in time: a paired block bootstrap.

Neighbouring frames show the same stretch of road, so their errors are alike. As independent frames, they would
give far too narrow intervals. So whole blocks are drawn, with replacement (Carlstein 1986, "The use of subseries
values"; Künsch 1989, "The jackknife and the bootstrap for general stationary observations"). Both networks are
measured on the same draw, so the difficulty of a block cancels out.

A measure such as the RMSE is a function of sums over frames. Each block is a row of sums, and a draw adds up rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import NormalDist
from typing import Final

import numpy as np
from numpy.typing import NDArray

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
