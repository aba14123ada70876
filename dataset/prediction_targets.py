"""Targets: the numbers that a network learns to predict. The first is always steering; a run may have more.

With one target, labels and answers are arrays (N,); with several (N, K), in the order in which the run names them,
steering first. All are numbers of the order of 1, so that their errors can be added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, TypeVar, get_args

from common.car import MAX_STEERING_DEG, SPEED_RANGE_MPH

if TYPE_CHECKING:  # flags need no NumPy
    import numpy as np
    from numpy.typing import NDArray

Values = TypeVar("Values", "NDArray[np.float32]", "NDArray[np.float64]")

TargetName = Literal["steering", "speed", "throttle"]
TARGET_NAMES: Final[tuple[TargetName, ...]] = get_args(TargetName)
STEERING_ONLY: Final[tuple[TargetName, ...]] = ("steering",)


@dataclass(frozen=True)
class Target:
    """A number that is learnt, and what people read in place of it."""

    name: TargetName
    unit: str  # that people read
    per_unit: float  # so many of these are 1 of what is learnt
    label_column: str  # of samples.parquet; in `unit`, but steering, which is -1..1
    answer_name: str  # of an answer, in `unit` but for steering: in tables and in ONNX
    most: float  # that a label is, above 0 and below


MAX_AHEAD_S: Final = 10.0
"""So much later at most is the speed driven that is learnt."""

TARGETS: Final = {
    target.name: target
    for target in (
        Target("steering", "°", MAX_STEERING_DEG, "label", "steering", 1.0),
        # 30 mph is as fast as the simulators drive; a network may answer more, or less than 0
        Target("speed", "mph", 30.0, "later_speed_mph", "speed_mph", SPEED_RANGE_MPH[1]),
        Target("throttle", "", 1.0, "throttle", "throttle", 1.0),  # -1: full brake
    )
}


def steering_in(values: Values) -> Values:
    """The steering (N,) in labels or answers, (N,) or (N, K)."""
    steering: Values = values if values.ndim == 1 else values[:, 0]
    return steering


def speed_ahead_s_in(settings: object) -> float:
    """The time from a picture to the speed that is its label, from the settings of an index (`IndexConfig`) as a
    file has them; 0 if they do not have it."""
    seconds = settings.get("speed_ahead_s") if isinstance(settings, dict) else None
    return float(seconds) if isinstance(seconds, int | float) and 0 <= seconds <= MAX_AHEAD_S else 0.0


def check_targets(names: Sequence[str]) -> None:
    """Raise ValueError for what are no targets of a run."""
    unknown = [name for name in names if name not in TARGETS]
    if unknown or list(names[:1]) != ["steering"] or len(set(names)) < len(names):
        raise ValueError(
            f"targets {' '.join(map(str, names)) or '(none)'}: steering first, then, each once, any of"
            f" {', '.join(TARGET_NAMES[1:])}"
        )
