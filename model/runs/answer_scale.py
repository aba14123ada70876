"""The answer scale: converts steering learnt from balanced samples to steering of natural driving.

Balanced samples have far more hard steering than the road. So the network answers a small deviation as if it were
a bend, but hairpins correctly. Small answers must shrink, and large ones stay. Natural steering is

    scale * learnt + curve * learnt * |learnt| + offset

A run's weights stay as learnt. Their file keeps the three numbers, and driving applies them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from common.steering_unit import assumed_deg, steering_unit

if TYPE_CHECKING:  # a run's history is read and shown without PyTorch
    from torch import Tensor

Floats = NDArray[np.float64]
Steering = TypeVar("Steering", Floats, "Tensor")

MIN_SCALE, MAX_SCALE = 0.1, 2.0
"""The bounds of a fit. Below MIN_SCALE, a network would ignore small deviations; above MAX_SCALE, it has not
learnt the road."""

MAX_CURVE: Final = 4.0
"""The curve is 0 or more, so the answer never falls while the learnt steering grows."""

MAX_OFFSET: Final = 0.2

_PREFIX: Final = "natural_"


@dataclass(frozen=True)
class AnswerScale:
    """Converts learnt steering to natural steering, -1..1, not clamped."""

    scale: float = 1.0
    offset: float = 0.0
    curve: float = 0.0

    @classmethod
    def fit(cls, learnt: Floats, steering: Floats) -> AnswerScale:
        """Fit `steering` (N,) to the network's answers `learnt` (N,) by least squares, within bounds.

        Returns the identity if all answers are equal, or if N is 0.
        """
        if not len(learnt) or np.ptp(learnt) == 0:
            return cls()
        line, bend, wanted = (values - values.mean() for values in (learnt, learnt * np.abs(learnt), steering))
        candidates = [*_inside(line, bend, wanted), *_at_edges(line, bend, wanted)]
        scale, curve = min(
            candidates, key=lambda fit: float(np.sum((wanted - fit[0] * line - fit[1] * bend) ** 2))
        )
        offset = np.mean(steering - cls(scale, 0.0, curve).natural(learnt))
        return cls(scale, float(np.clip(offset, -MAX_OFFSET, MAX_OFFSET)), curve)

    def __post_init__(self) -> None:
        """Raises ValueError for numbers beyond the bounds."""
        is_inside = MIN_SCALE <= self.scale <= MAX_SCALE and 0 <= self.curve <= MAX_CURVE
        if not (is_inside and abs(self.offset) <= MAX_OFFSET):
            raise ValueError(f"answer scale {self.scale:g}, {self.curve:g}, {self.offset:g}: out of bounds")

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> AnswerScale:
        """The scale in the metadata of weights; the identity if they have none. Raises ValueError beyond the
        bounds."""
        return cls(
            **{name: float(metadata.get(_PREFIX + name, default)) for name, default in asdict(cls()).items()}
        )

    @property
    def metadata(self) -> dict[str, str]:
        """The three numbers as text, for the metadata of a file of weights."""
        return {_PREFIX + name: repr(value) for name, value in asdict(self).items()}

    def in_words(self, max_deg: float | None) -> str:
        """The formula in degrees, where steering 1 is `max_deg`: "0.10 x + 0.040 x|x| of the x degrees
        learnt, -0.20"."""
        unit = steering_unit(max_deg)
        full = unit.of(assumed_deg(max_deg))
        curve = f" + {self.curve / full:.3f} x|x|" if self.curve else ""
        return f"{self.scale:.2f} x{curve} of the x {unit.name} learnt, {full * self.offset:+.2f}"

    def natural(self, learnt: Steering) -> Steering:
        return learnt * (self.scale + self.curve * abs(learnt)) + self.offset

    def learnt(self, natural: Floats) -> Floats:
        """The learnt steering for a natural one: the inverse of `natural`."""
        steering = natural - self.offset
        # the non-negative root of curve * x**2 + scale * x = |steering|, in a form in which curve may be 0
        size = 2 * np.abs(steering) / (self.scale + np.sqrt(self.scale**2 + 4 * self.curve * np.abs(steering)))
        return np.sign(steering) * size


def _inside(line: Floats, bend: Floats, wanted: Floats) -> list[tuple[float, float]]:
    """The scale and curve of least squares; empty if they are out of bounds."""
    (scale, curve), *_ = np.linalg.lstsq(np.stack([line, bend], 1), wanted)
    is_inside = MIN_SCALE <= scale <= MAX_SCALE and 0 <= curve <= MAX_CURVE
    return [(float(scale), float(curve))] if is_inside else []


def _at_edges(line: Floats, bend: Floats, wanted: Floats) -> list[tuple[float, float]]:
    """The best scale at either bound of the curve, and the best curve at either bound of the scale."""
    scales, curves = (MIN_SCALE, MAX_SCALE), (0.0, MAX_CURVE)
    of_curves = [(_slope(line, wanted - curve * bend, *scales), curve) for curve in curves]
    return of_curves + [(scale, _slope(bend, wanted - scale * line, *curves)) for scale in scales]


def _slope(values: Floats, wanted: Floats, low: float, high: float) -> float:
    square = float(values @ values)
    return float(np.clip(values @ wanted / square, low, high)) if square > 0 else low
