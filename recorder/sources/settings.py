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
