"""The flags of `bc-record --gym` and `bc-drive --gym`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Final

import tyro


@dataclass(frozen=True)
class GymFlags:
    """A Gymnasium environment, and where in it the picture, the steering and the speed are."""

    gym: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """A Gymnasium environment: CarRacing-v3, or MODULE:ID such as simulator:bc/Lake-v0."""
    gym_args: Annotated[str, tyro.conf.arg(metavar="JSON")] = "{}"
    """Arguments of the environment, such as {"seed": 7}."""
    gym_picture: Annotated[str | None, tyro.conf.arg(metavar="KEY")] = None
    """Key of the picture in a Dict observation; by default the only picture."""
    gym_action: Annotated[str | None, tyro.conf.arg(metavar="PARTS")] = None
    """Meaning of each number of the action, such as -steering,0.5*throttle,brake."""
    gym_speed: Annotated[str | None, tyro.conf.arg(metavar="KEY")] = None
    """Key of the speed in mph, in observation or info; 2.237*KEY for m/s."""
    expert: Annotated[str | None, tyro.conf.arg(metavar="MODULE:FUNCTION")] = None
    """Your function that drives: (env, observation) to action; also FILE.py:FUNCTION."""
    gym_rate: Annotated[float | None, tyro.conf.arg(metavar="HZ")] = None
    """Steps a second, if the environment has no render_fps."""
    episodes: int = 1
    """Episodes of the environment, each with the next seed."""


GYM_FLAGS: Final = tuple(field.name for field in fields(GymFlags) if field.name != "gym")
"""The flags that mean nothing without `--gym`."""
