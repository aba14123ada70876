"""Settings of recordings: a drive of the built-in simulator, topics of other logs, live telemetry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple, TypeAlias

import tyro

from simulator.driving.drive_limits import DriverName

if TYPE_CHECKING:  # NumPy
    from recorder.log.session_car import Car
import math
from dataclasses import field, fields
from typing import Any, Final

from common.errors import UsageError, printable
from common.stored_settings import settings_of_file
from recorder.errors import RecordingError
from simulator.driving.vehicle import STEP_S


@dataclass(frozen=True)
class SimulatedDrive:
    """A drive of the built-in simulator."""

    RARE: ClassVar[str] = "recovery noise"
    track: Annotated[str, tyro.conf.arg(metavar="TRACK")] = "lake"
    """lake, mountain, random:SEED, or hairpins:SEED."""
    driver: DriverName = "expert"
    """The expert, or a simulated person at keyboard or mouse."""
    laps: float = 1.0
    """Laps at each speed."""
    speed: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MPH [MPH ...]")] = (10.0,)
    """Set speeds, one drive each; the driver slows for bends."""
    rate: Annotated[float, tyro.conf.arg(metavar="HZ")] = 10.0
    """Recorded rows a second: a divisor of 100, at most 50."""
    recovery: float = 0.35
    """Share of rows in which the car returns to the line."""
    noise: float = 0.03
    """Unsteadiness of the steering; 0.03 is a calm person."""
    seed: int = 0
    """Same seed, same log."""


@dataclass(frozen=True)
class PersonDrive:
    """A person's drive in the built-in simulator."""

    track: Annotated[str, tyro.conf.arg(metavar="TRACK")] = "lake"
    """lake, mountain, random:SEED, or hairpins:SEED."""
    laps: float | None = None
    """End after these laps; by default when you end it."""
    start: Annotated[float, tyro.conf.arg(metavar="METRES")] = 0.0
    """Where to start."""
    speed: Annotated[float, tyro.conf.arg(metavar="MPH")] = 10.0
    """The speed that the page offers to hold."""
    rate: Annotated[float, tyro.conf.arg(metavar="HZ")] = 10.0
    """Recorded rows a second: a divisor of 100, at most 50."""


TimeUnit: TypeAlias = Literal["s", "ms", "us", "ns"]


@dataclass(frozen=True)
class ImportSettings:
    """What the user says of a recording. All formats take the same; each uses what fits it."""

    RARE: ClassVar[str] = "camera time_unit steering_offset max_steering_age"
    image: Annotated[str | None, tyro.conf.arg(metavar="TOPIC")] = None
    """Topic of the pictures, or a LeRobot dataset's feature."""
    steering: Annotated[str | None, tyro.conf.arg(metavar="TOPIC.FIELD")] = None
    """The steering: /cmd_vel.angular.z; for LeRobot: action.steering."""
    camera: Annotated[tuple[str, ...], tyro.conf.arg(metavar="left=TOPIC [right=TOPIC]")] = ()
    """Topics of side cameras, beside --image."""
    columns: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WHAT=COLUMN [WHAT=COLUMN ...]")] = ()
    """Columns of a csv: image=frame steering=angle, and more."""
    rate: Annotated[float | None, tyro.conf.arg(metavar="HZ")] = None
    """Rows a second, of a recording without times."""
    time_unit: TimeUnit | None = None
    """Unit of the recording's times, if it is not the usual one."""
    steering_scale: float = 1.0
    """Factor to -1 (left) .. 1 (right); negative for ROS."""
    steering_offset: float = 0.0
    """Added to the steering before the scale: -0.53 if 0.53 is straight on."""
    max_steering_age: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 1.0
    """How long a steering message stays in force."""


class ListenSettings(NamedTuple):
    """Where a simulator connects, its car, and when the recording ends."""

    host: str = "127.0.0.1"
    port: int = 4567  # 0: a free one
    idle_s: float | None = None  # the recording ends this long after the last telemetry
    car: Car | None = None  # the recorded car, if it is not Udacity's or the built-in one's
    on_started: Callable[[Path], None] | None = None  # gets the path of the growing file when the server listens


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


MIN_HZ: Final = 1.0  # at lower rates, each row would be a drive of its own
MAX_HZ: Final = 1000.0
_TINY: Final = 1e-6


def check_rate(rate_hz: float | None) -> None:
    """Raise RecordingError for a rate that no camera has."""
    if rate_hz is not None and not MIN_HZ <= rate_hz <= MAX_HZ:
        raise RecordingError(f"--rate {rate_hz:g}: give frames a second, {MIN_HZ:g} to {MAX_HZ:,.0f}")


def describe_clock(rate_hz: float) -> str:
    """The description of such times in a log's metadata."""
    return f"{rate_hz:g} Hz, as --rate said, because the recording has no times"


def check_row_rate(rate_hz: float) -> None:
    """Raise RecordingError for a person's rate unless rows are a whole number of half steps apart, at least one
    step."""
    half_steps = 2 / (rate_hz * STEP_S) if rate_hz > 0 else 0.0
    if half_steps < 2 - _TINY or abs(half_steps - round(half_steps)) > _TINY:
        raise RecordingError(f"--rate {rate_hz:g}: expected a divisor of 100, at most 50, such as 10 or 20")


def is_row_step(step: int, rate_hz: float) -> bool:
    """True if this step has a row. At 20 rows a second, rows are alternately 2 and 3 steps apart."""
    rows_a_step = rate_hz * STEP_S
    row = math.ceil(step * rows_a_step - _TINY)
    return math.floor(row / rows_a_step + _TINY) == step
