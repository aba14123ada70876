"""The optional `world` member of a telemetry: the pose, the road, the clock, an expert's command.

It comes from outside and may be anything; each member is checked by itself.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

from recorder.server.locale_numbers import POINT
from simulator.pose import Pose

MAX_WORLD_NUMBER: Final = 1e9  # of any unit but time_s: a million kilometres
MAX_TIME_S: Final = 1e12  # Unix time in seconds is about 2e9; in milliseconds it is beyond

CLOCK_STANDING: Final = "time_s does not advance: this computer's clock counts instead"
"""The notice about a clock that stands still (`recorder.log.log_time.StandingClock`)."""

_GROUPS: Final = (
    ("x_m", "y_m", "z_m", "heading_rad", "pitch_rad", "roll_rad"),
    ("expert_steering", "expert_throttle"),
)
"""Members that mean nothing without each other."""

_KINDS: Final[dict[type, str]] = {
    type(None): "null",
    bool: "true or false",
    int: "a number",
    float: "a number",
    str: "a string",
    bytes: "binary data",
    list: "a list",
    dict: "an object",
}


def json_kind(value: object) -> str:
    """The kind of a value of JSON or Socket.IO in words: "a list"."""
    return _KINDS.get(type(value), "something else")


@dataclass(frozen=True)
class World:
    """The checked members of a telemetry's `world`; None for those that were not sent.

    The real simulator sends none of them. The pose is whole or absent, and so is the expert's command.
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
        values = [getattr(self, name) for name in _GROUPS[0]]
        return None if None in values else Pose(*values)

    @property
    def expert(self) -> tuple[float, float] | None:
        """The expert's steering and throttle."""
        if self.expert_steering is None or self.expert_throttle is None:
            return None
        return self.expert_steering, self.expert_throttle


class WorldNotices:
    """The notices about one simulator's `world`, each of them once."""

    def __init__(self) -> None:
        self._noticed: set[str] = set()

    def new_notices(self, problems: Iterable[str], *, clock_stands: bool) -> list[str]:
        """The notices that are due after a telemetry with these problems (`parse_world`)."""
        current = [*problems, CLOCK_STANDING] if clock_stands else problems
        new = [problem for problem in current if problem not in self._noticed]
        self._noticed.update(new)
        return [f"the simulator's world is not used whole: {problem}" for problem in new]


MEMBERS: Final = tuple(field.name for field in fields(World))


def parse_world(value: object, decimal: str = POINT) -> tuple[World | None, tuple[str, ...]]:
    """The usable members of a telemetry's `world`, None if there are none, and the problems with the others.

    Numbers may stand in strings, with `decimal` for the point; whole ones may be written as 2.0.
    Members that are null or unknown are ignored. A problem has a member's name and no value: it is the same text
    from one telemetry to the next.
    """
    if value is None:
        return None, ()
    if not isinstance(value, Mapping):
        return None, (f"it is not an object but {json_kind(value)}",)
    problems: list[str] = []
    members: dict[str, Any] = {}
    for name in MEMBERS:
        if value.get(name) is None:
            continue
        try:
            members[name] = _member(name, value[name], decimal)
        except ValueError as error:
            problems.append(f"{name} {error}")
    if not members and not problems:
        return None, (f"none of its members is known, which are {', '.join(MEMBERS)}",)
    for group in _GROUPS:
        present = [name for name in group if name in members]
        if present and len(present) < len(group):
            missing = [name for name in group if value.get(name) is None]
            if missing:
                problems.append(f"{' and '.join(missing)} missing: they belong to {present[0]}")
            for name in present:
                del members[name]
    return (World(**members) if members else None), tuple(problems)


def _member(name: str, value: object, decimal: str) -> float | int:
    """A member's number. Raises ValueError with the problem."""
    if isinstance(value, str):
        # no thousands separator: 1,234 would be ambiguous
        if len(value) >= 64 or not re.fullmatch(
            rf"\s*[+-]?[0-9]+({re.escape(decimal)}[0-9]+)?([eE][+-]?[0-9]+)?\s*", value
        ):
            raise ValueError("is a string that is no plain number")
        number: float | int = float(value.replace(decimal, POINT))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        number = value
    else:
        raise ValueError(f"is not a number but {json_kind(value)}")
    # refuses NaN, and numbers that overflow in calculations
    most = MAX_TIME_S if name == "time_s" else MAX_WORLD_NUMBER
    if not -most <= number <= most:
        raise ValueError(f"is beyond {most:g}, or no number")
    if name == "interventions":
        if number != int(number) or number < 0:
            raise ValueError("is not a whole number from 0 on")
        return int(number)
    return min(max(float(number), -1.0), 1.0) if name in _GROUPS[1] else float(number)
