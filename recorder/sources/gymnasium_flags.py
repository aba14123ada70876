"""The flags of `bc-drive --gym`, and the settings of their environment."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated, Any, ClassVar, Final

import tyro

from common.errors import UsageError, printable
from common.stored_settings import settings_of_file


@dataclass(frozen=True)
class GymFlags:
    """A Gymnasium environment."""

    RARE: ClassVar[str] = "episodes"
    gym: Annotated[str | None, tyro.conf.arg(metavar="ID|FILE.toml")] = None
    """The environment: CarRacing-v3, MODULE:ID, or a file of its settings."""
    expert: Annotated[str | None, tyro.conf.arg(metavar="MODULE:FUNCTION")] = None
    """Your driver, (env, observation) to action; also FILE.py:FUNCTION."""
    episodes: int = 1
    """Episodes, each with the next seed."""


GYM_FLAGS: Final = tuple(flag.name for flag in fields(GymFlags) if flag.name != "gym")
"""The flags that need `--gym`."""
REMOVED_GYM_FLAGS: Final = {
    f"--gym-{setting.removesuffix('_hz')}": f"name a file that has {setting}: --gym FILE.toml"
    for setting in ("args", "picture", "action", "speed", "rate_hz")
}


@dataclass(frozen=True)
class EnvironmentSettings:
    """A Gymnasium environment and the meaning of its numbers: the content of a file for `--gym`."""

    id: str  # for gymnasium.make
    args: dict[str, Any] = field(default_factory=dict)  # for gymnasium.make
    action: str = "steering"  # the meaning of each number, such as -steering,0.5*throttle,brake
    picture: str | None = None  # its key in a Dict observation
    speed: str | None = None  # key of the speed in mph, in the observation or info; 2.237*KEY for m/s
    rate_hz: float | None = None  # steps a second, if the environment has no render_fps


def environment_settings(flags: GymFlags) -> EnvironmentSettings:
    """The environment that `flags` name. Raises UsageError for a file that cannot be read, or has
    unknown settings."""
    name = str(flags.gym)
    try:
        return settings_of_file(EnvironmentSettings, name) if name.endswith(".toml") else EnvironmentSettings(name)
    except ValueError as error:
        raise UsageError(f"{printable(name)}: {error}") from None
