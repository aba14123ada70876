"""The unit in which steering is shown: degrees, or percent of full lock if the car's steering angle is unknown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from common.car import MAX_STEERING_DEG


@dataclass(frozen=True)
class SteeringUnit:
    """A unit to show steering in. Angles are stored in degrees; if the car's angle is unknown, steering 1 is
    stored as `MAX_STEERING_DEG`."""

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
    """The unit for a car whose wheels turn by `max_deg` at steering 1; None if unknown."""
    return FULL_LOCK if max_deg is None else DEGREES


def assumed_deg(max_deg: float | None) -> float:
    """The angle at steering 1, in degrees: `max_deg`, or `MAX_STEERING_DEG` if it is unknown."""
    return MAX_STEERING_DEG if max_deg is None else max_deg
