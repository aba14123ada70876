"""The clock of a drive: the simulator's if it sends its time, else this computer's. Events of its course."""

from __future__ import annotations

import math
from typing import Final

from recorder.log.log_time import LONGEST_STEP_S, StandingClock
from recorder.server.world import World


class DriveClock:
    """Seconds since the first telemetry message. The clock never goes back.

    If two successive messages have the simulated time, the clock advances by their difference, unless that time
    jumps. Else it advances by this computer's time. So a drive in lock-step is the same on slow and fast
    computers, and a message with another clock, or without one, does not move the clock by hours. A simulated
    clock that stands still while this computer's clock runs is ignored.
    """

    def __init__(self) -> None:
        self._time_s = 0.0
        self._now_s: float | None = None
        self._world_s: float | None = None
        self._standing = StandingClock()
        self.safety_s = 0.0
        """Seconds. Each step is the longer one of both clocks, so that neither delays a brake or its release."""
        self.missed_s = 0.0
        """Seconds to add at the last message: a simulated clock that proved to stand still had not counted
        them."""
        self.is_simulated = False  # True if the last step was by the simulator's clock

    @property
    def stands(self) -> bool:
        """True after the simulator's clock has proved to stand still."""
        return self._standing.stands

    def advance(self, now_s: float, world: World | None) -> float:
        """The drive's time of a telemetry message that arrived at `now_s` of a monotonic clock."""
        world_s = None if world is None else world.time_s
        passed_s = computer_s = 0.0 if self._now_s is None else now_s - self._now_s
        self.is_simulated = False
        stood_s, stood = self._standing.stood_s, self.stands
        self.missed_s = stood_s if self._standing.note(now_s, world_s) and not stood else 0.0
        if self.stands:
            world_s = None
        if world_s is not None and self._world_s is not None and world_s - self._world_s <= LONGEST_STEP_S:
            passed_s, self.is_simulated = world_s - self._world_s, True
        self._now_s, self._world_s = now_s, world_s
        self.safety_s += max(0.0, passed_s, computer_s)
        self._time_s += max(0.0, passed_s)
        return self._time_s


PUT_BACK: Final = "off the road, or stuck: the simulator put the car back"


class CourseEvents:
    """Compares the world of each telemetry message with earlier ones. The first one gives no event."""

    def __init__(self) -> None:
        self._interventions: int | None = None
        self._whole_laps: int | None = None

    def update(self, world: World) -> list[str]:
        events = []
        if world.interventions is not None:
            if self._interventions is not None and world.interventions > self._interventions:
                events.append(PUT_BACK)
            self._interventions = world.interventions
        if world.laps is not None:
            whole_laps = math.floor(world.laps)
            if self._whole_laps is not None and whole_laps > self._whole_laps:
                events.append(f"lap {whole_laps}")
            # the maximum so far: a line that is crossed backwards and again counts one lap
            self._whole_laps = max(whole_laps, self._whole_laps or 0)
        return events
