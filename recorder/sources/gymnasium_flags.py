"""The flags of `bc-record --gym` and `bc-drive --gym`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Final

import tyro


@dataclass(frozen=True)
class GymFlags:
    """A Gymnasium environment, and where in it the picture, the steering and the speed are."""

    gym: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """A Gymnasium environment, such as CarRacing-v3 or simulator:bc/Lake-v0 (the module that has it before the
    colon)."""
    gym_args: Annotated[str, tyro.conf.arg(metavar="JSON")] = "{}"
    """What --gym's environment is made with: {"seed": 7}."""
    gym_picture: Annotated[str | None, tyro.conf.arg(metavar="KEY")] = None
    """Where in a Dict observation the camera's picture is (pixels, or pixels.front); by default the only one."""
    gym_action: Annotated[str | None, tyro.conf.arg(metavar="PARTS")] = None
    """What each number of the action is, separated by commas: steering, throttle, brake, pedals (throttle less
    brake), or a constant. -steering where left is positive; 0.5*throttle for another scale."""
    gym_speed: Annotated[str | None, tyro.conf.arg(metavar="KEY")] = None
    """Where in a Dict observation, or in info, the speed in mph is; 2.237*KEY for m/s. By default: unknown."""
    expert: Annotated[str | None, tyro.conf.arg(metavar="MODULE:FUNCTION")] = None
    """Who drives --gym's environment: a function of your own, or FILE.py:FUNCTION, from (env, observation) to an
    action."""
    gym_rate: Annotated[float | None, tyro.conf.arg(metavar="HZ")] = None
    """Steps a second of --gym's environment, where its render_fps does not give them."""
    episodes: int = 1
    """How many episodes of --gym's environment; each resets it with the next seed."""


GYM_FLAGS: Final = tuple(field.name for field in fields(GymFlags) if field.name != "gym")
"""The flags that mean nothing without `--gym`."""
