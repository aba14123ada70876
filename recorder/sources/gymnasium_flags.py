"""The flags of `bc-record --gym` and `bc-drive --gym`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, ClassVar, Final

import tyro


@dataclass(frozen=True)
class GymFlags:
    """A Gymnasium environment."""

    RARE: ClassVar[str] = "gym_args gym_picture gym_speed gym_rate episodes"
    gym: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """The environment: CarRacing-v3, or MODULE:ID."""
    gym_args: Annotated[str, tyro.conf.arg(metavar="JSON")] = "{}"
    """Its arguments, such as {"seed": 7}."""
    gym_picture: Annotated[str | None, tyro.conf.arg(metavar="KEY")] = None
    """Key of the picture in a Dict observation."""
    gym_action: Annotated[str | None, tyro.conf.arg(metavar="PARTS")] = None
    """Meaning of the action, such as -steering,0.5*throttle,brake."""
    gym_speed: Annotated[str | None, tyro.conf.arg(metavar="KEY")] = None
    """Key of the speed in mph; 2.237*KEY for m/s."""
    expert: Annotated[str | None, tyro.conf.arg(metavar="MODULE:FUNCTION")] = None
    """Your driver, (env, observation) to action; also FILE.py:FUNCTION."""
    gym_rate: Annotated[float | None, tyro.conf.arg(metavar="HZ")] = None
    """Steps a second, without render_fps."""
    episodes: int = 1
    """Episodes, each with the next seed."""


GYM_FLAGS: Final = tuple(field.name for field in fields(GymFlags) if field.name != "gym")
"""The flags that mean nothing without `--gym`."""
