"""Targets: the numbers that a network learns to predict. The first is always steering; a run may have more.

With one target, labels and predictions are arrays (N,); with several, (N, K) in the order of the run's targets,
steering first. All values are about -1..1, so that their errors can be added.
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
    """A number that a network learns, and the unit in which it is shown."""

    name: TargetName
    unit: str  # in which it is shown
    per_unit: float  # units per 1 of the learnt value
    label_column: str  # in samples.parquet; in `unit`, except steering, which is -1..1
    answer_name: str  # name of a prediction in tables and in ONNX; in `unit`, except steering
    max_label: float  # labels are -max_label..max_label


MAX_AHEAD_S: Final = 10.0  # maximum time from a picture to the speed that is its label

TARGETS: Final = {
    target.name: target
    for target in (
        Target("steering", "°", MAX_STEERING_DEG, "label", "steering", 1.0),
        # 30 mph is the top speed of the simulators; a network may predict more, or less than 0
        Target("speed", "mph", 30.0, "later_speed_mph", "speed_mph", SPEED_RANGE_MPH[1]),
        Target("throttle", "", 1.0, "throttle", "throttle", 1.0),  # -1: full brake
    )
}


def steering_in(values: Values) -> Values:
    """The steering (N,) in labels or predictions, (N,) or (N, K)."""
    steering: Values = values if values.ndim == 1 else values[:, 0]
    return steering


def speed_ahead_s_in(settings: object) -> float:
    """The time in seconds from a picture to the speed that is its label, from stored settings of an index
    (`IndexConfig`); 0 if the settings lack it."""
    seconds = settings.get("speed_ahead_s") if isinstance(settings, dict) else None
    return float(seconds) if isinstance(seconds, int | float) and 0 <= seconds <= MAX_AHEAD_S else 0.0


def check_targets(names: Sequence[str]) -> None:
    """Raise ValueError if the names are not valid targets of a run."""
    unknown = [name for name in names if name not in TARGETS]
    if unknown or list(names[:1]) != ["steering"] or len(set(names)) < len(names):
        raise ValueError(
            f"targets {' '.join(map(str, names)) or '(none)'}: expected steering first, then, each at most once,"
            f" any of {', '.join(TARGET_NAMES[1:])}"
        )
