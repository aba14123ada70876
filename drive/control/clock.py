"""The clock of a drive: the simulator's own where it tells one, else this computer's."""

from __future__ import annotations

from recorder.log.log_time import LONGEST_STEP_S, StandingClock
from recorder.server.world import World


class DriveClock:
    """Seconds since the first telemetry; they never go back.

    Between two telemetries that both tell the simulated time, that is what passes, unless it jumps; between any
    others, the time of this computer. So a drive in lock-step depends on nobody's speed, and one telemetry with
    another clock, or with none, does not move the drive's clock by hours. A simulated clock that stands while this
    computer's runs on is not used.
    """

    def __init__(self) -> None:
        self._time_s = 0.0
        self._now_s: float | None = None
        self._world_s: float | None = None
        self._standing = StandingClock()
        self.safety_s = 0.0
        """Of each step, what that clock says that says more: none puts off a brake, or its release."""
        self.missed_s = 0.0
        """What was taken for no time, and was found at the last telemetry to be that of a clock that stands."""
        self.is_simulated = False
        """Whether what passed before the last telemetry is by the simulator's own clock."""

    @property
    def stands(self) -> bool:
        """Whether the simulator's clock was found not to run."""
        return self._standing.stands

    def at(self, now_s: float, world: World | None) -> float:
        """The time of a telemetry that came at `now_s` of a monotonic clock."""
        world_s = None if world is None else world.time_s
        passed_s = least_s = 0.0 if self._now_s is None else now_s - self._now_s
        self.is_simulated = False
        stood_s, stood = self._standing.stood_s, self.stands
        self.missed_s = stood_s if self._standing.note(now_s, world_s) and not stood else 0.0
        if self.stands:
            world_s = None
        if world_s is not None and self._world_s is not None and world_s - self._world_s <= LONGEST_STEP_S:
            passed_s, self.is_simulated = world_s - self._world_s, True
        self._now_s, self._world_s = now_s, world_s
        self.safety_s += max(0.0, passed_s, least_s)
        self._time_s += max(0.0, passed_s)
        return self._time_s
