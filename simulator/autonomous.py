"""Autonomous mode: the built-in simulator in the real one's place on the wire.

In lock-step, simulated time stands still until an answer comes, so that a drive depends on the answers alone, and
not on how fast anybody's machine is. As with the real simulator two telemetries are in flight: the car acts on
what it saw one step ago.
"""

from __future__ import annotations

import hashlib
import struct
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from simulator.client import Answer, SimulatorClient, Steer, Telemetry, Told
from simulator.course import Measures
from simulator.simulation import Simulation

DEFAULT_RATE_HZ = 25.0


@dataclass(frozen=True)
class Driven:
    """A finished drive."""

    track: str
    whole_laps: int
    measures: Measures
    unreadable: int  # commands that were not numbers
    trajectory_sha256: str  # of every pose: two drives with the same one went the same way

    def as_dict(self) -> dict[str, Any]:
        values = asdict(self)
        return {**values.pop("measures"), **values}


def drive_autonomously(
    simulation: Simulation,
    client: SimulatorClient,
    *,
    laps: float,
    rate_hz: float = DEFAULT_RATE_HZ,
    real_time: bool = False,
    progress: Callable[[float], None] = lambda laps: None,
) -> Driven:
    """Drive `laps` from the start, at `rate_hz` telemetries a second of simulated time (it must divide 50).

    A car that leaves the road or does not get on is put back on the centre line, and that is counted. With
    `real_time`, simulated time passes no faster than the clock. `progress` is told the laps driven so far.

    Raises WaitTimeoutError where no server answers.
    """
    course = simulation.course
    course.start()
    step_s = 1.0 / rate_hz
    trajectory = hashlib.sha256()
    command = Steer(0.0, 0.0)
    start_s = 0.0

    def next_telemetry(answer: Answer) -> Told:
        nonlocal command, start_s
        if isinstance(answer, Steer):
            command = answer
            start_s = start_s or time.monotonic()
            if real_time:
                time.sleep(max(0.0, start_s + course.time_s - time.monotonic()))
            course.advance(command.steering, command.throttle, step_s)
            if course.intervention_due:
                course.intervene()
            pose = course.pose
            trajectory.update(struct.pack("<4d", pose.x_m, pose.y_m, pose.z_m, pose.heading_rad))
            progress(course.laps)
            if course.laps >= laps:
                return None
        # braking does not show in the real simulator's telemetry either
        throttle = min(max(command.throttle, 0.0), 1.0)
        car = course.vehicle
        return Telemetry(min(max(car.steering, -1.0), 1.0), throttle, car.speed_mph, simulation.jpeg())

    client.run(next_telemetry)
    return Driven(
        simulation.track.name, course.whole_laps, course.measures, client.bad_steers, trajectory.hexdigest()
    )
