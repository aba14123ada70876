"""The optional `world` member of a telemetry: the pose, the road, the clock, an expert's command.

It is untrusted; each member is checked separately.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

from recorder.server.locale_numbers import POINT
from simulator.pose import Pose

MAX_WORLD_NUMBER: Final = 1e9  # in any unit, except of time_s: a million kilometres
MAX_TIME_S: Final = 1e12  # Unix time is about 2e9 in seconds, and above the limit in milliseconds

CLOCK_STANDING: Final = "time_s does not advance: this computer's clock counts instead"
"""The notice about a standing clock (`recorder.log.log_time.StandingClock`)."""

_GROUPS: Final = (
    ("x_m", "y_m", "z_m", "heading_rad", "pitch_rad", "roll_rad"),
    ("expert_steering", "expert_throttle"),
)
"""Members that are useless without each other."""

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
    """The kind of a JSON or Socket.IO value in words: "a list"."""
    return _KINDS.get(type(value), "something else")


@dataclass(frozen=True)
class World:
    """The checked members of a telemetry's `world`; None for missing ones.

    The real simulator sends none of them. The pose is complete or absent, and so is the expert's command.
    """

    time_s: float | None = None  # the simulated clock, from any start, such as Unix time
    x_m: float | None = None  # of the ground under the middle of the rear axle: east, north, up
    y_m: float | None = None
    z_m: float | None = None
    heading_rad: float | None = None  # counter-clockwise from +x
    pitch_rad: float | None = None  # nose up is positive
    roll_rad: float | None = None  # right side down is positive
    offset: float | None = None  # from the centre line, as a share of the road's half width, positive to the left
    laps: float | None = None  # driven
    interventions: int | None = None  # how often the simulator has put the car back on the road; 0 or more
    expert_steering: float | None = None  # -1 (left) .. 1 (right): its expert's command now
    expert_throttle: float | None = None  # -1 .. 1

    @property
    def pose(self) -> Pose | None:
        values = [getattr(self, name) for name in _GROUPS[0]]
        return None if None in values else Pose(*values)

    @property
    def expert(self) -> tuple[float, float] | None:
        if self.expert_steering is None or self.expert_throttle is None:
            return None
        return self.expert_steering, self.expert_throttle


class WorldNotices:
    """The notices about a simulator's `world`, each once."""

    def __init__(self) -> None:
        self._noticed: set[str] = set()

    def new_notices(self, problems: Iterable[str], *, clock_stands: bool) -> list[str]:
        """The new notices after a telemetry with these problems (`parse_world`)."""
        current = [*problems, CLOCK_STANDING] if clock_stands else problems
        new = [problem for problem in current if problem not in self._noticed]
        self._noticed.update(new)
        return [f"the simulator's world is not used whole: {problem}" for problem in new]


MEMBERS: Final = tuple(field.name for field in fields(World))


def parse_world(value: object, decimal: str = POINT) -> tuple[World | None, tuple[str, ...]]:
    """The usable members of a telemetry's `world` (None without any), and the problems with the others.

    Numbers may be strings, with `decimal` as the point; whole numbers may be written as 2.0. Null and unknown
    members are ignored. A problem has a member's name, but no value: its text is the same in every telemetry.
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
    # also refuses NaN, and numbers that overflow in calculations
    most = MAX_TIME_S if name == "time_s" else MAX_WORLD_NUMBER
    if not -most <= number <= most:
        raise ValueError(f"is beyond {most:g}, or no number")
    if name == "interventions":
        if number != int(number) or number < 0:
            raise ValueError("is not a whole number from 0 on")
        return int(number)
    return min(max(float(number), -1.0), 1.0) if name in _GROUPS[1] else float(number)
