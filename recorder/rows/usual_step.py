"""The usual time between two rows of a log."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_NEAR: Final = 0.6  # of the median
_UNEVEN: Final = 0.1  # of it


def usual_step(steps: NDArray[Any]) -> float:
    """The median of steps (N,), N > 0, above 0. Where they alternate, as 0.04 and 0.06 s of a person's 20 rows a
    second, the mean of those near it."""
    median = float(np.median(steps))
    near = steps[np.abs(steps - median) <= _NEAR * median]
    if not len(near):  # the median of an even number may lie between two far from it
        return median
    mean = float(near.mean())
    return mean if abs(mean - median) > _UNEVEN * median else median
