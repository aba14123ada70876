"""The answer scale: from the steering that a network learnt of balanced samples to that of natural driving.

Where every steering bin counts alike, the prior of hard steering is far above that of the road, and the network
answers accordingly: too much. Its kept weights are those that answer naturally; the scale and offset that were
brought into their last layer stand beside them, so that what was learnt can be told as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # a run's history is read and shown without PyTorch
    from torch import Tensor

LEAST_SCALE, MOST_SCALE = 0.1, 2.0
"""What a fit may give: beyond it, the network knows nothing of the road, and no scale helps."""

MOST_OFFSET: Final = 0.2

_PREFIX: Final = "answer_"


@dataclass(frozen=True)
class AnswerScale:
    """Natural steering is `scale` times what was learnt, plus `offset`; -1..1, not clamped."""

    scale: float = 1.0
    offset: float = 0.0

    @classmethod
    def fit(cls, learnt: NDArray[np.float64], steering: NDArray[np.float64]) -> AnswerScale:
        """The least squares of `steering` (N,) by the network's answers `learnt` (N,), within bounds.

        As learnt, where the network answers the same to everything, or where there is nothing to fit.
        """
        if not len(learnt) or np.ptp(learnt) == 0:
            return cls()
        spread = learnt - learnt.mean()
        scale = float(np.clip(spread @ steering / (spread @ spread), LEAST_SCALE, MOST_SCALE))
        offset = float(np.clip(steering.mean() - scale * learnt.mean(), -MOST_OFFSET, MOST_OFFSET))
        return cls(scale, offset)

    def __post_init__(self) -> None:
        """Raises ValueError for what no fit gives."""
        if not (LEAST_SCALE <= self.scale <= MOST_SCALE and abs(self.offset) <= MOST_OFFSET):
            raise ValueError(f"an answer scale of {self.scale:g} with an offset of {self.offset:g}")

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> AnswerScale:
        """That of a file of weights; as learnt where none is told. Raises ValueError for what no fit gives."""
        return cls(**{name: float(metadata.get(_PREFIX + name, of)) for name, of in asdict(cls()).items()})

    @property
    def metadata(self) -> dict[str, str]:
        """For a file of weights."""
        return {_PREFIX + name: repr(value) for name, value in asdict(self).items()}

    def natural(self, learnt: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.scale * learnt + self.offset

    def learnt(self, natural: NDArray[np.float64]) -> NDArray[np.float64]:
        return (natural - self.offset) / self.scale

    def bring_into(self, weights: Mapping[str, Tensor], last_layer: str) -> dict[str, Tensor]:
        """These weights with a last layer that gives natural steering."""
        weight, bias = f"{last_layer}.weight", f"{last_layer}.bias"
        return {
            **weights,
            weight: weights[weight] * self.scale,
            bias: weights[bias] * self.scale + self.offset,
        }
