"""Steering bins: equal parts of -1..1."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

BINS: Final = 25  # the number of bins in the original project, and the default for an index


def bin_of(steering: NDArray[np.float64], bins: int) -> NDArray[np.int64]:
    """The bin of each steering, for `bins` equal bins over -1..1: 0 (left) .. bins - 1 (right).

    A value on an edge belongs to the bin farther from zero, so that a mirrored distribution has mirrored counts.
    """
    import numpy as np  # not at the top: `--help` imports this module for BINS

    outward = np.minimum(np.floor((np.abs(steering) + 1.0) * (bins / 2.0)).astype(np.int64), bins - 1)
    return np.where(steering >= 0, outward, bins - 1 - outward)
