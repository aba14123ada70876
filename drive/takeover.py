"""Who drives the built-in simulator's car: the network, or the expert where the network leaves the lane."""

from __future__ import annotations

from typing import Final

from recorder.telemetry import World

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
"""The network must wish to steer as the expert does, but for this: 5 degrees, a correction and no turn."""
HAND_BACK_S: Final = 1.0
"""Both for so long without a break: a car that only crosses the middle is through sooner."""

PILOT_DRIVES: Final = "the pilot drives again"
_LONGEST_GAP_S: Final = 0.5  # between two telemetries that tell a sideways speed


class Takeover:
    """The expert takes over before the car is off the road, and hands back when all has been well for a while."""

    def __init__(self) -> None:
        self.expert_drives = False
        self._last_world: World | None = None
        self._well_since_s: float | None = None
        self._said_missing = False

    def after(self, time_s: float, world: World | None, predicted_steering: float) -> list[str]:
        """Decide who drives on from `time_s`; what there is to say of it. Without a world the network drives."""
        ahead = 0.0 if world is None else world.offset + TAKE_OVER_AHEAD_S * self._sideways_per_s(world)
        self._last_world = world
        if world is None:
            return self._without_world()
        if self.expert_drives:
            return self._hand_back(time_s, world, predicted_steering)
        if abs(ahead) <= TAKE_OVER_OFFSET:
            return []
        self.expert_drives, self._well_since_s = True, None
        side = "left" if ahead > 0 else "right"
        return [f"the expert takes over: {abs(world.offset):.2f} of the half width, and going off to the {side}"]

    def _sideways_per_s(self, world: World) -> float:
        """How fast the offset grows to the left; 0 where the last telemetry does not tell it."""
        last = self._last_world
        # a car that was put back has not driven there
        if last is None or last.interventions != world.interventions:
            return 0.0
        passed_s = world.time_s - last.time_s
        return (world.offset - last.offset) / passed_s if 0 < passed_s <= _LONGEST_GAP_S else 0.0

    def _hand_back(self, time_s: float, world: World, predicted_steering: float) -> list[str]:
        disagreement = abs(predicted_steering - world.expert_steering)
        if abs(world.offset) > HAND_BACK_OFFSET or disagreement > HAND_BACK_STEERING:
            self._well_since_s = None
        elif self._well_since_s is None:
            self._well_since_s = time_s
        elif time_s - self._well_since_s >= HAND_BACK_S:
            self.expert_drives = False
            return [PILOT_DRIVES]
        return []

    def _without_world(self) -> list[str]:
        events = [PILOT_DRIVES] if self.expert_drives else []
        if not self._said_missing:
            events.append("nobody can take over: the simulator tells no world (`bc-sim --tell-world` does)")
        self.expert_drives, self._said_missing = False, True
        return events
