"""The unit in which people read steering: degrees, or shares of full lock where the car's angle is unknown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from common.car import MAX_STEERING_DEG


@dataclass(frozen=True)
class SteeringUnit:
    """Angles are kept in degrees; of a car whose angle is unknown they are those of `MAX_STEERING_DEG` at
    steering 1."""

    name: str  # after a number and a space, or alone
    sign: str  # right after a number
    short: str  # after a number and a space, in narrow places
    per_deg: float

    def of(self, degrees: float) -> float:
        """An angle in this unit."""
        return degrees * self.per_deg


DEGREES: Final = SteeringUnit("degrees", "°", "deg", 1.0)
FULL_LOCK: Final = SteeringUnit("% of full lock", " %", "%", 100 / MAX_STEERING_DEG)


def steering_unit(max_deg: float | None) -> SteeringUnit:
    """The unit for a car whose wheels turn by `max_deg` at steering 1; None: unknown."""
    return FULL_LOCK if max_deg is None else DEGREES


def assumed_deg(max_deg: float | None) -> float:
    """The angle that degrees are counted with: `MAX_STEERING_DEG` where it is unknown."""
    return MAX_STEERING_DEG if max_deg is None else max_deg
