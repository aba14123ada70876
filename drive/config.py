"""The configuration of a drive: set speed, smoothing, takeover."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from common import UserError
from simulator.driving.drive_limits import MAX_SPEED_MPH

if TYPE_CHECKING:
    from recorder.log.session_car import Car


class DriveError(UserError):
    """A drive cannot start, because its speed or its course is invalid, or its simulator has failed."""


@dataclass(frozen=True)
class DriveConfig:
    """The settings of a drive. Raises DriveError, which names the flag, for an invalid value."""

    set_speed_mph: float = 10.0
    slow_in_curves: bool = False  # drive slower if the steering would push the car outwards at the set speed
    smooth_s: float = 0.0  # time constant of the steering's smoothing; 0: off
    max_steering_per_s: float = 0.0  # largest change of the steering in a second; 0: no limit
    takeover: bool = False  # the simulator's expert takes over before the car leaves its lane
    car: Car | None = None  # the driven car; None: unknown, treated as Udacity's

    def __post_init__(self) -> None:
        if not 0 < self.set_speed_mph <= MAX_SPEED_MPH:
            expected = f"give a speed above 0 mph and up to {MAX_SPEED_MPH} (the car reaches 30)"
            raise DriveError(f"--speed {self.set_speed_mph:g}: {expected}")
        if not 0 <= self.smooth_s < math.inf:
            raise DriveError(f"--smooth {self.smooth_s:g}: give a time constant in seconds; 0 is off")
        if not 0 <= self.max_steering_per_s < math.inf:
            raise DriveError(
                f"--steering-rate {self.max_steering_per_s:g}: give the steering's change in a second"
                " (2 is from one lock to the other); 0 is no limit"
            )
