"""The flags of a drive of the built-in simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from simulator.driving.drive_limits import DriverName


@dataclass(frozen=True)
class SimulatedDrive:
    """A drive of the built-in simulator: its driver, track and settings."""

    track: str = "lake"
    """Track of the built-in simulator: lake, mountain, random:SEED, or hairpins:SEED."""
    driver: DriverName | Literal["me"] = "expert"
    """Who drives: the expert, a simulated person at keyboard or mouse, or you (me)."""
    laps: float | None = None
    """Laps at each speed, 1 by default; 0.5: half the track."""
    start: Annotated[float, tyro.conf.arg(metavar="METRES")] = 0.0
    """With --driver me: start, along the track."""
    speed: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MPH [MPH ...]")] = (10.0,)
    """Set speeds in mph, one drive each; the driver slows for bends."""
    rate: Annotated[float, tyro.conf.Suppress] = 10.0  # bc-record has a --rate of its own
    """Recorded rows a second; it must divide 50."""
    recovery: float = 0.35
    """Share of the rows in which the car returns after an unrecorded push."""
    noise: float = 0.03
    """Unsteadiness of the steering; 0: a machine's, 0.03: a calm person's."""
    seed: int = 0
    """Same seed, same log; also the seed of --gym's first episode."""
