"""The meaning of the numbers in an environment's action: steering, throttle, brake, or a constant."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

NAMES: Final = ("steering", "throttle", "brake", "pedals")
"""`pedals` is the throttle minus the brake, in one number."""

_NUMBER: Final = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_PART: Final = re.compile(rf"(?:({_NUMBER})|(?:({_NUMBER})\*|(-))?({'|'.join(NAMES)}))", re.ASCII)


@dataclass(frozen=True)
class CarCommand:
    steering: float  # -1 (left) .. 1 (right)
    throttle: float = 0.0  # 0 .. 1
    brake: float = 0.0  # 0 .. 1


@dataclass(frozen=True)
class _Part:
    name: str  # empty for a constant
    factor: float  # the action's number divided by ours; or the constant


class ActionMap:
    """Converts commands to actions, and actions to commands. Its text has a part for each number of the action,
    separated by commas: a name, a name with a factor (`-steering`, `0.5*throttle`), or a constant."""

    def __init__(self, text: str) -> None:
        """Raises ValueError for another text, or one without steering."""
        self.text = text
        self._parts = [_parse(part.strip()) for part in text.split(",")]
        names = [part.name for part in self._parts if part.name]
        if names.count("steering") != 1:
            raise ValueError("one number of the action has to be the steering")
        if len(set(names)) < len(names) or ("pedals" in names and {"throttle", "brake"} & set(names)):
            raise ValueError("throttle and brake may be given once each, or pedals for both")
        self.has_pedals = len(names) > 1

    def __len__(self) -> int:
        return len(self._parts)

    def action(self, command: CarCommand) -> NDArray[np.float64]:
        """The numbers of the action (N,)."""
        values = {
            "": 1.0,
            "steering": command.steering,
            "throttle": command.throttle,
            "brake": command.brake,
            "pedals": command.throttle - command.brake,
        }
        return np.array([part.factor * values[part.name] for part in self._parts])

    def turned(self, action: NDArray[np.float64], by: float) -> NDArray[np.float64]:
        """An action (N,) with `by` added to its steering."""
        added = [part.factor * by if part.name == "steering" else 0.0 for part in self._parts]
        return np.add(action, added, dtype=np.float64)

    def command(self, action: NDArray[Any]) -> CarCommand:
        """The command of an action (N,), limited to its ranges. Missing pedals are 0."""
        named = {
            part.name: float(number) / part.factor
            for part, number in zip(self._parts, action, strict=True)
            if part.name
        }
        pedals = named.get("pedals", 0.0)
        return CarCommand(
            steering=min(max(named["steering"], -1.0), 1.0),
            throttle=min(max(named.get("throttle", pedals), 0.0), 1.0),
            brake=min(max(named.get("brake", -pedals), 0.0), 1.0),
        )


def _parse(text: str) -> _Part:
    match = _PART.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r}: expected a number, or {', '.join(NAMES)} with or without a factor")
    constant, factor, minus, name = match.groups()
    if name is None:
        return _Part("", float(constant))
    value = -1.0 if minus else float(factor or 1.0)
    if value == 0.0 or not math.isfinite(1.0 / value):
        raise ValueError(f"{text!r}: expected a factor other than 0")
    return _Part(name, value)
