"""The takeovers: the simulator's expert drives where the network leaves the lane, a person at the first touch of
a key, stick or wheel."""

from __future__ import annotations

from typing import Final

from drive.control.speed_controller import SpeedController
from recorder.log.session_car import Car
from recorder.rows.devices import Device
from recorder.server.world import World
from recorder.teleop.seat import Control
from recorder.teleop.wheel import Wheel

# Tried with networks that fail for seconds at a time, on three tracks: no takeover came too late at 10 and 15 mph,
# one in thirteen at 20. By the offset alone, from 0.7 of the half width on, it was one in eight at 15, half at 20.
TAKE_OVER_OFFSET: Final = 0.9
"""The expert takes over where the car's middle would be farther from the centre line than this share of the half
width (at 1 the simulator puts the car back) ..."""
TAKE_OVER_AHEAD_S: Final = 0.7
"""... after this time, moving sideways as it does. The expert needs as long to catch it: a command takes hold one
telemetry and 0.1 s of steering lag later, and then wheels and car must turn before the car comes back."""

HAND_BACK_OFFSET: Final = 0.3
"""It hands back no farther out than this: it comes back to 0.15 even in a hairpin."""
HAND_BACK_STEERING: Final = 0.2
"""The largest difference between the network's steering and the expert's: 5 degrees, a correction and no turn."""
HAND_BACK_S: Final = 1.0
"""Both must hold for so long without a break: a car that only crosses the middle is through sooner."""

REQUIRED_MEMBERS: Final = ("offset", "expert_steering", "expert_throttle")
"""The members of a simulator's world without which no expert can take over."""

MISSING_S: Final = 1.0
"""The time until a notice that they are missing: some simulators send them from the second telemetry on."""

PILOT_DRIVES: Final = "the pilot drives again"
TAKES_OVER: Final = "a person takes over"
NOBODY: Final = "nobody is at the wheel: the network drives on"
_LONGEST_GAP_S: Final = 0.5  # between two telemetries that give a sideways speed


class Takeover:
    """Chooses the driver: the expert takes over before the car is off the road, and hands back once it is
    steady."""

    def __init__(self) -> None:
        self.expert_drives = False
        self._last: tuple[float, float, int | None] | None = None  # time, offset, interventions
        self._hand_back_since_s: float | None = None
        self._missing_since_s: float | None = None
        self._reported_missing = False

    def update(self, time_s: float, world: World | None, predicted_steering: float) -> list[str]:
        """Choose the driver from `time_s` on, and return the events of that. `time_s` is by the simulator's clock
        where it sends one. Where the world lacks the car's offset or the expert's command, the network drives."""
        if world is None or world.offset is None or world.expert is None:
            self._last = None
            return self._without_expert(time_s, world)
        self._missing_since_s = None
        ahead = world.offset + TAKE_OVER_AHEAD_S * self._sideways_per_s(time_s, world.offset, world.interventions)
        self._last = time_s, world.offset, world.interventions
        if self.expert_drives:
            return self._hand_back(time_s, world.offset, abs(predicted_steering - world.expert[0]))
        if abs(ahead) <= TAKE_OVER_OFFSET:
            return []
        self.expert_drives, self._hand_back_since_s = True, None
        side = "left" if ahead > 0 else "right"
        return [f"the expert takes over: {abs(world.offset):.2f} of the half width, and going off to the {side}"]

    def _sideways_per_s(self, time_s: float, offset: float, interventions: int | None) -> float:
        """The speed of the offset, positive to the left; 0 where the last telemetry does not give it."""
        if self._last is None:
            return 0.0
        last_s, last_offset, last_interventions = self._last
        if last_interventions != interventions:  # a car that was put back has not driven there
            return 0.0
        return (offset - last_offset) / (time_s - last_s) if 0 < time_s - last_s <= _LONGEST_GAP_S else 0.0

    def _hand_back(self, time_s: float, offset: float, disagreement: float) -> list[str]:
        if abs(offset) > HAND_BACK_OFFSET or disagreement > HAND_BACK_STEERING:
            self._hand_back_since_s = None
        elif self._hand_back_since_s is None:
            self._hand_back_since_s = time_s
        elif time_s - self._hand_back_since_s >= HAND_BACK_S:
            self.expert_drives = False
            return [PILOT_DRIVES]
        return []

    def _without_expert(self, time_s: float, world: World | None) -> list[str]:
        events = [PILOT_DRIVES] if self.expert_drives else []
        self.expert_drives = False
        if self._missing_since_s is None:
            self._missing_since_s = time_s
        if not self._reported_missing and time_s - self._missing_since_s >= MISSING_S:
            self._reported_missing = True
            missing = [name for name in REQUIRED_MEMBERS if getattr(world, name, None) is None]
            events.append(
                f"nobody can take over: the simulator does not send {', '.join(missing)} (`bc-sim --tell-world`"
                " does); in Udacity's, a human takes over by holding a key"
            )
        return events


class PersonTakeover:
    """Chooses the driver: the network, or the person at a wheel."""

    def __init__(self, wheel: Wheel, set_speed_mph: float, car: Car | None) -> None:
        self._wheel = wheel
        self._car = car
        self._speed = SpeedController(set_speed_mph, car=car)
        self.control = Control()
        """The controls of the last `update`."""
        self.person_drives = False

    @property
    def device(self) -> Device | None:
        """What the person steers with; None while the network drives."""
        return self.control.device if self.person_drives else None

    def update(self) -> list[str]:
        """Choose the driver by the newest controls, and return the events of that."""
        self.control = self._wheel.control()
        if not self.person_drives:
            if not self.control.is_touching:
                return []
            self.person_drives = True
            return [TAKES_OVER]
        if self.control.is_absent:
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
        control = self.control
        if control.hold_mph is None or speed_mph is None or control.throttle < 0.0:  # the brake comes first
            return control.steering, control.throttle
        if control.hold_mph != self._speed.set_speed_mph:
            self._speed = SpeedController(control.hold_mph, car=self._car)
        return control.steering, self._speed.throttle(speed_mph)
