"""Steering bins: equal parts of -1..1."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

BINS: Final = 25
"""The number of bins of the original project, and of an index by default."""


def bin_of(steering: NDArray[np.float64], bins: int) -> NDArray[np.int64]:
    """The one of `bins` equal bins over -1..1 that each steering falls into: 0 (left) .. bins - 1 (right).

    An edge belongs to the bin farther from zero, on both sides: a mirrored distribution has mirrored counts.
    """
    import numpy as np  # flags, which name the number of bins, need none

    outward = np.minimum(np.floor((np.abs(steering) + 1.0) * (bins / 2.0)).astype(np.int64), bins - 1)
    return np.where(steering >= 0, outward, bins - 1 - outward)
