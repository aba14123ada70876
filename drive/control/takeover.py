"""The takeovers: by the simulator's expert before the car leaves its lane, by a person at the first touch of a
key, stick or wheel."""

from __future__ import annotations

import math
from typing import Final

from recorder.server.world import World
from recorder.teleop.cockpit import Cockpit
from recorder.teleop.pedals import throttle_of_telemetry
from recorder.topics import Device

# On three tracks, with networks that fail for seconds at a time, no takeover was too late at 10 and 15 mph, and
# one in thirteen at 20 mph. With the offset alone (0.7 of the half width): one in eight at 15 mph, half at 20 mph.
TAKE_OVER_OFFSET: Final = 0.9
"""The expert takes over if the car's middle will be farther from the centre line than this share of the half width
after `TAKE_OVER_AHEAD_S`. At 1, the simulator puts the car back."""
TAKE_OVER_AHEAD_S: Final = 0.7
"""The offset is extrapolated by this time at its present rate. The expert needs this time to catch the car: a
command takes effect one message and 0.1 s of steering lag later, and then wheels and car must turn."""

HAND_BACK_OFFSET: Final = 0.3
"""The largest offset at which the expert hands back. It returns to 0.15 even in a hairpin."""
HAND_BACK_STEERING: Final = 0.2
"""The largest difference between the network's and the expert's steering for handing back: 5 degrees, a
correction."""
HAND_BACK_S: Final = 1.0
"""Both conditions must hold for this time without a break: a car that only crosses the middle does so faster."""

MISSING_S: Final = 1.0
"""The time until a notice of missing members: some simulators send them only from the second message on."""

PILOT_DRIVES: Final = "the pilot drives again"
TAKES_OVER: Final = "a person takes over"
NOBODY: Final = "nobody is at the wheel: the network drives on"
NOBODY_BRAKED: Final = "nobody is at the wheel: the car is braked"
_LONGEST_GAP_S: Final = 0.5  # between two messages that give a sideways speed


class Takeover:
    """Chooses the driver: the expert takes over before the car leaves the road, and hands back when the car is
    steady."""

    def __init__(self) -> None:
        self.expert_drives = False
        self._last: tuple[float, float, int | None] | None = None  # time, offset, interventions
        self._hand_back_since_s: float | None = None
        self._missing_since_s: float | None = None
        self._reported_missing = False

    def update(self, time_s: float, world: World | None, predicted_steering: float) -> list[str]:
        """Choose the driver from `time_s` on. Returns the events. `time_s` is by the simulator's clock if it sends
        its time. If the world lacks the car's offset or the expert's command, the network drives."""
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
        return [f"the expert takes over: {abs(world.offset):.2f} of the half width, and moving off to the {side}"]

    def _sideways_per_s(self, time_s: float, offset: float, interventions: int | None) -> float:
        """The rate of the offset per second, positive to the left; 0 if the last message does not give it."""
        if self._last is None:
            return 0.0
        last_s, last_offset, last_interventions = self._last
        if last_interventions != interventions:  # the car was put back: the offset has jumped
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
            needed = ("offset", "expert_steering", "expert_throttle")
            missing = [name for name in needed if getattr(world, name, None) is None]
            events.append(
                f"nobody can take over: the simulator does not send {', '.join(missing)} (`bc-sim --tell-world`"
                " does); in Udacity's, a human takes over by holding a key"
            )
        return events


class PersonTakeover:
    def __init__(self, cockpit: Cockpit) -> None:
        self._cockpit = cockpit
        self.person_drives = False

    @property
    def device(self) -> Device | None:
        """The person's steering device; None while the network drives."""
        return self._cockpit.control.device if self.person_drives else None

    def update(self, *, is_braked: bool) -> list[str]:
        """Choose the driver by the newest controls. Returns the events. `is_braked`: the car is braked, and
        the network does not drive it either."""
        control = self._cockpit.take_control()
        if not self.person_drives:
            if not control.is_touching:
                return []
            self.person_drives = True
            return [TAKES_OVER]
        if control.is_absent:
            self.person_drives = False
            return [NOBODY_BRAKED if is_braked else NOBODY]
        return []

    def hand_back(self) -> list[str]:
        """Let the network drive until the next touch. Returns the events."""
        if not self.person_drives:
            return []
        self.person_drives = False
        return [PILOT_DRIVES]

    def command(self, speed_mph: float | None) -> tuple[float, float]:
        control = self._cockpit.control
        return control.steering, throttle_of_telemetry(control, math.nan if speed_mph is None else speed_mph)
