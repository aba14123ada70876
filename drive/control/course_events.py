"""Events of the course: laps, and cars that the simulator put back on the road."""

from __future__ import annotations

import math
from typing import Final

from recorder.server.world import World

PUT_BACK: Final = "off the road, or stuck: the simulator put the car back"


class CourseEvents:
    """Compares the world of each telemetry message with earlier ones. The first one gives no event."""

    def __init__(self) -> None:
        self._interventions: int | None = None
        self._whole_laps: int | None = None

    def update(self, world: World) -> list[str]:
        """The events since the last call."""
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
