"""The `world`: what a simulator may tell beside its telemetry. It comes from outside, and may be anything."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

from recorder.server.locale_numbers import POINT
from simulator.pose import Pose

MAX_WORLD_NUMBER: Final = 1e9  # of any unit but time_s: a million kilometres; what is beyond is no world
MAX_TIME_S: Final = 1e12  # Unix time is about 2e9; milliseconds of it are beyond

CLOCK_STANDS: Final = "time_s does not advance: this computer's clock counts instead"
"""What is said of a clock that does (`recorder.log.log_time.StandingClock`)."""

_TOGETHER: Final = (
    ("x_m", "y_m", "z_m", "heading_rad", "pitch_rad", "roll_rad"),
    ("expert_steering", "expert_throttle"),
)
"""Members that say nothing without each other."""


@dataclass(frozen=True)
class World:
    """What the real simulator never tells, and others may, each member by itself: None is what was not told.

    Of the pose there is all or nothing, as of the expert.
    """

    time_s: float | None = None  # the simulated clock; it may begin anywhere, as Unix time does
    x_m: float | None = None  # of the ground under the middle of the rear axle: east, north, up
    y_m: float | None = None
    z_m: float | None = None
    heading_rad: float | None = None  # counter-clockwise from +x
    pitch_rad: float | None = None  # nose up is positive
    roll_rad: float | None = None  # right side down is positive
    offset: float | None = None  # from the centre line, as a share of the road's half width, positive to the left
    laps: float | None = None  # driven
    interventions: int | None = None  # how often the simulator has put the car back on the road; never negative
    expert_steering: float | None = None  # -1 (left) .. 1 (right): what its expert would command now
    expert_throttle: float | None = None  # -1 .. 1

    @property
    def pose(self) -> Pose | None:
        values = [getattr(self, name) for name in _TOGETHER[0]]
        return None if None in values else Pose(*values)

    @property
    def expert(self) -> tuple[float, float] | None:
        """Its steering and throttle."""
        if self.expert_steering is None or self.expert_throttle is None:
            return None
        return self.expert_steering, self.expert_throttle


class WorldProblems:
    """Says of everything that is wrong with what one simulator tells of its world, once."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def news(self, problems: Iterable[str], *, clock_stands: bool) -> list[str]:
        """What there is to say of a telemetry with these problems (`parse_world`)."""
        told = [*problems, CLOCK_STANDS] if clock_stands else problems
        new = [problem for problem in told if problem not in self._said]
        self._said.update(new)
        return [f"the simulator's world is not used whole: {problem}" for problem in new]


MEMBERS: Final = tuple(field.name for field in fields(World))


def parse_world(value: object, decimal: str = POINT) -> tuple[World | None, tuple[str, ...]]:
    """What can be used of a telemetry's `world`, None if nothing can, and what is wrong with the rest of it.

    Numbers may stand in strings, with `decimal` for the point; whole ones may be written as 2.0.
    Members that are null, or that nobody here knows, are passed over. What is wrong is told by name and kind,
    without values: the same from one telemetry to the next.
    """
    if value is None:
        return None, ()
    if not isinstance(value, Mapping):
        return None, (f"it is not an object but a {type(value).__name__}",)
    problems: list[str] = []
    told: dict[str, Any] = {}
    for name in MEMBERS:
        if value.get(name) is None:
            continue
        try:
            told[name] = _member(name, value[name], decimal)
        except ValueError as error:
            problems.append(f"{name} {error}")
    if not told and not problems:
        return None, (f"none of its members is known, which are {', '.join(MEMBERS)}",)
    for group in _TOGETHER:
        known = [name for name in group if name in told]
        if known and len(known) < len(group):
            missing = [name for name in group if value.get(name) is None]
            if missing:
                problems.append(f"{' and '.join(missing)} missing beside {known[0]}: they go together")
            for name in known:
                del told[name]
    return (World(**told) if told else None), tuple(problems)


def _member(name: str, value: object, decimal: str) -> float | int:
    """Raises ValueError that says what is wrong."""
    if isinstance(value, str):
        # no separator of thousands: in 1,234 nobody knows which it is
        if len(value) >= 64 or not re.fullmatch(
            rf"\s*[+-]?[0-9]+({re.escape(decimal)}[0-9]+)?([eE][+-]?[0-9]+)?\s*", value
        ):
            raise ValueError("is a string that is no plain number")
        number: float | int = float(value.replace(decimal, POINT))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        number = value
    else:
        raise ValueError(f"is not a number but a {type(value).__name__}")
    # neither NaN, nor what overflows where somebody calculates with it
    most = MAX_TIME_S if name == "time_s" else MAX_WORLD_NUMBER
    if not -most <= number <= most:
        raise ValueError(f"is beyond {most:g}, or no number")
    if name == "interventions":
        if number != int(number) or number < 0:
            raise ValueError("is no count: a whole number from 0 on was expected")
        return int(number)
    return min(max(float(number), -1.0), 1.0) if name in _TOGETHER[1] else float(number)
