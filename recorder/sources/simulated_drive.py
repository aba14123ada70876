"""The flags of a drive of the built-in simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import tyro

from simulator.driving.drive_limits import DriverName


@dataclass(frozen=True)
class SimulatedDrive:
    """A drive of the built-in simulator."""

    RARE: ClassVar[str] = "start recovery noise"
    track: str = "lake"
    """lake, mountain, random:SEED, or hairpins:SEED."""
    driver: DriverName | Literal["me"] = "expert"
    """The expert, a simulated person at keyboard or mouse, or you (me)."""
    laps: float | None = None
    """Laps at each speed; by default 1."""
    start: Annotated[float, tyro.conf.arg(metavar="METRES")] = 0.0
    """With --driver me: where to start."""
    speed: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MPH [MPH ...]")] = (10.0,)
    """Set speeds, one drive each; the driver slows for bends."""
    rate: Annotated[float, tyro.conf.Suppress] = 10.0  # bc-record has a --rate of its own
    """Recorded rows a second; it must divide 50."""
    recovery: float = 0.35
    """Share of rows in which the car returns to the line."""
    noise: float = 0.03
    """Unsteadiness of the steering; 0.03 is a calm person."""
    seed: int = 0
    """Same seed, same log; with --gym the first episode's seed."""
