"""The takeover by a person: the first touch of a key, stick or wheel takes the car from the network."""

from __future__ import annotations

from typing import Final

from drive.control.speed_controller import SpeedController
from drive.control.takeover import PILOT_DRIVES
from recorder.log.session_car import Car
from recorder.rows.devices import Device
from recorder.teleop.seat import Control
from recorder.teleop.wheel import Wheel

TAKES_OVER: Final = "a person takes over"
NOBODY: Final = "nobody is at the wheel: the network drives on"


class PersonTakeover:
    """Chooses the driver: the network, or the person at a wheel."""

    def __init__(self, wheel: Wheel, set_speed_mph: float, car: Car | None) -> None:
        self._wheel = wheel
        self._car = car
        self._speed = SpeedController(set_speed_mph, car=car)
        self._control = Control()
        self.person_drives = False

    @property
    def device(self) -> Device | None:
        """What the person steers with; None while the network drives."""
        return self._control.device if self.person_drives else None

    @property
    def control(self) -> Control:
        """The controls of the last `update`."""
        return self._control

    def update(self) -> list[str]:
        """Choose the driver by the newest controls, and return the events of that."""
        self._control = self._wheel.control()
        if not self.person_drives:
            if not self._control.is_touching:
                return []
            self.person_drives = True
            return [TAKES_OVER]
        if self._control.is_absent:
            self.person_drives = False
            return [NOBODY]
        return []

    def hand_back(self) -> list[str]:
        """The network drives again, until the next touch; the events of that."""
        if not self.person_drives:
            return []
        self.person_drives = False
        return [PILOT_DRIVES]

    def command(self, speed_mph: float | None) -> tuple[float, float]:
        """Steering and throttle of the person, at the car's speed, if that is known."""
        control = self._control
        if control.hold_mph is None or speed_mph is None:
            return control.steering, control.throttle
        if control.throttle < 0.0:  # the brake comes first
            return control.steering, control.throttle
        if control.hold_mph != self._speed.set_speed_mph:
            self._speed = SpeedController(control.hold_mph, car=self._car)
        return control.steering, self._speed.throttle(speed_mph)
