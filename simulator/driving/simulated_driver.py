"""The drivers of the built-in simulator: their interface, and the drivers by name."""

from __future__ import annotations

from typing import Final, Protocol

from simulator.driving.course import Course
from simulator.driving.drive_limits import DriverName
from simulator.driving.expert import Expert
from simulator.driving.person import KeyboardDriver, MouseDriver
from simulator.roads.centreline import Centreline


class SimulatedDriver(Protocol):
    """A driver of a course. `control` is called at every step of the simulator."""

    def control(self, course: Course) -> tuple[float, float]:
        """The command for the course's present state: steering -1 (left) .. 1 (right), throttle -1 .. 1."""
        ...


_DRIVERS: Final[dict[DriverName, type[Expert | KeyboardDriver | MouseDriver]]] = {
    "expert": Expert,
    "keyboard": KeyboardDriver,
    "mouse": MouseDriver,
}


def make_driver(
    name: DriverName, line: Centreline, set_speed_mph: float, noise: float, seed: int
) -> SimulatedDriver:
    """A driver of the road ``line``. Raises ValueError for a speed of 0 or less, or a negative noise."""
    return _DRIVERS[name](line, set_speed_mph, noise, seed)
