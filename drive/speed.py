"""Holding a speed: the proportional-integral controller of the original project, with a bounded integral."""

from __future__ import annotations

from typing import Final

from drive.errors import DriveError

KP: Final = 0.1  # throttle for each mph too slow
KI: Final = 0.002  # throttle for each mph too slow, summed over telemetries
MAX_INTEGRAL_THROTTLE: Final = 0.5  # without a bound, a long climb winds up a throttle that outlasts it


def check_set_speed(set_speed_mph: float) -> None:
    """Raises DriveError for a set speed that no car of the simulator's kind holds."""
    if not 0 < set_speed_mph <= 100:
        raise DriveError(f"--speed {set_speed_mph:g}: give a speed above 0 mph and up to 100 (the car reaches 30)")


class SpeedController:
    """One telemetry in, one throttle out."""

    def __init__(self, set_speed_mph: float) -> None:
        self.set_speed_mph = set_speed_mph
        self._integral = 0.0

    def throttle(self, speed_mph: float) -> float:
        """-1 (full brake) .. 1 (full throttle)."""
        error = self.set_speed_mph - speed_mph
        bound = MAX_INTEGRAL_THROTTLE / KI
        self._integral = min(max(self._integral + error, -bound), bound)
        return min(max(KP * error + KI * self._integral, -1.0), 1.0)
