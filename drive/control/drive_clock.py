"""The clock of a drive: the simulator's own where it sends one, else this computer's."""

from __future__ import annotations

from recorder.log.log_time import LONGEST_STEP_S, StandingClock
from recorder.server.world import World


class DriveClock:
    """Seconds since the first telemetry; they never go back.

    Between two telemetries that both hold the simulated time, that time passes, unless it jumps; between any
    others, the time of this computer. So a drive in lock-step is the same on slow and fast computers, and one
    telemetry with another clock, or with none, does not move the drive's clock by hours. A simulated clock that
    stands still while this computer's runs on is not used.
    """

    def __init__(self) -> None:
        self._time_s = 0.0
        self._now_s: float | None = None
        self._world_s: float | None = None
        self._standing = StandingClock()
        self.safety_s = 0.0
        """Seconds. Each step is the longer one of both clocks, so that neither delays a brake or its release."""
        self.missed_s = 0.0
        """Seconds to be added at the last telemetry: a clock that proved to stand still had counted them as
        none."""
        self.is_simulated = False
        """True if the time before the last telemetry is the simulator's."""

    @property
    def stands(self) -> bool:
        """True once the simulator's clock has proved to stand still."""
        return self._standing.stands

    def advance(self, now_s: float, world: World | None) -> float:
        """The drive's time of a telemetry that came at `now_s` of a monotonic clock."""
        world_s = None if world is None else world.time_s
        passed_s = min_s = 0.0 if self._now_s is None else now_s - self._now_s
        self.is_simulated = False
        stood_s, stood = self._standing.stood_s, self.stands
        self.missed_s = stood_s if self._standing.note(now_s, world_s) and not stood else 0.0
        if self.stands:
            world_s = None
        if world_s is not None and self._world_s is not None and world_s - self._world_s <= LONGEST_STEP_S:
            passed_s, self.is_simulated = world_s - self._world_s, True
        self._now_s, self._world_s = now_s, world_s
        self.safety_s += max(0.0, passed_s, min_s)
        self._time_s += max(0.0, passed_s)
        return self._time_s
