"""Autonomous mode: the built-in simulator connects to a server in the place of the real one.

In lock-step, simulated time stands still until an answer comes, so that a drive depends on the answers alone, and
not on how fast anybody's machine is. As with the real simulator two telemetries are in flight: the car acts on
what it saw one step ago. So does an expert whose command is sent with the picture, and who is sent to the wheel:
one more command of the network comes before his first.
"""

from __future__ import annotations

import hashlib
import math
import struct
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from simulator.driving.course import Course, CourseMeasures
from simulator.driving.expert import Expert
from simulator.driving.simulation import Simulation
from simulator.pose import Pose
from simulator.protocol.client import (
    ServerCommand,
    SimulatorClient,
    SimulatorMessage,
    SimulatorTelemetry,
    SteerCommand,
)

# An expert who takes the wheel at full lock has the car back on the road, and a metre on, within 10 s. A course
# calls it stuck meanwhile, because progress is made on the road only.
RECOVERY_LIMIT_S = 10.0

GIVE_UP_S = 60.0
"""A car that has not come a metre farther for so long, however often it was put back, never will."""


@dataclass(frozen=True)
class AutonomousDrive:
    track: str
    whole_laps: int
    measures: CourseMeasures
    gave_up: bool  # before all laps were driven: see `GIVE_UP_S`
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
    start_m: float = 0.0,
    rate_hz: float,
    real_time: bool = False,
    expert: Expert | None = None,
    leave_off_road: bool = False,
    progress: Callable[[float], None] = lambda laps: None,
    lost: Callable[[], object] = lambda: None,
) -> AutonomousDrive:
    """Drive `laps` from `start_m` along the track, at `rate_hz` telemetries a second of simulated time, which must
    divide 50.

    A car that leaves the road or does not get on is put back on the centre line, and that is counted; with
    `leave_off_road`, only one that has been stuck for `RECOVERY_LIMIT_S`, for its driver may bring it back. So is
    any car where a command asks for it. A car that gets nowhere for `GIVE_UP_S` ends the drive. With `real_time`,
    simulated time passes no faster than the clock. With `expert`, each telemetry holds the world too, and what the
    expert would command where its picture was taken. `progress` is called with the laps driven so far, `lost` when
    the server has gone, which is then waited for.

    Raises WaitTimeoutError where no server answers.
    """
    course = simulation.course
    course.start(start_m)
    step_s = 1.0 / rate_hz
    trajectory = hashlib.sha256()
    command = SteerCommand(0.0, 0.0)
    start_s = 0.0
    stuck_since_s = math.inf
    farthest_m, farthest_s, gave_up = 0.0, 0.0, False

    def must_intervene() -> bool:
        nonlocal stuck_since_s
        stuck_since_s = min(stuck_since_s, course.time_s) if course.stuck else math.inf
        return course.time_s - stuck_since_s >= RECOVERY_LIMIT_S if leave_off_road else course.intervention_due

    def next_telemetry(received: ServerCommand) -> SimulatorMessage:
        nonlocal command, start_s, farthest_m, farthest_s, gave_up
        if isinstance(received, SteerCommand):
            command = received
            if real_time:  # after a delay, too: nobody can steer a car that makes up for lost time
                start_s = max(start_s, time.monotonic() - course.time_s)
                time.sleep(max(0.0, start_s + course.time_s - time.monotonic()))
            course.advance(command.steering, command.throttle, step_s)
            if must_intervene() or command.puts_back:
                course.intervene()
            pose = course.pose
            trajectory.update(struct.pack("<4d", pose.x_m, pose.y_m, pose.z_m, pose.heading_rad))
            progress(course.laps)
            if course.progress_m >= farthest_m + 1.0:
                farthest_m, farthest_s = course.progress_m, course.time_s
            gave_up = course.laps < laps and course.time_s - farthest_s >= GIVE_UP_S
            if course.laps >= laps or gave_up:
                return None
        else:
            pose = course.pose
        # braking does not show in the real simulator's telemetry either
        throttle = min(max(command.throttle, 0.0), 1.0)
        car = course.vehicle
        steering = min(max(car.steering, -1.0), 1.0)
        world = _world(course, pose, expert) if expert is not None else None
        return SimulatorTelemetry(steering, throttle, car.speed_mph, simulation.jpeg(pose=pose), world)

    client.run(next_telemetry, lost)
    return AutonomousDrive(
        simulation.track.name,
        course.whole_laps,
        course.measures,
        gave_up,
        client.bad_steers,
        trajectory.hexdigest(),
    )


def _world(course: Course, pose: Pose, expert: Expert) -> dict[str, float]:
    """The `world` field of a telemetry. Its names and units are those of `recorder.server.world.World`."""
    expert_steering, expert_throttle = expert.control(course)
    return {
        "time_s": course.time_s,
        **asdict(pose),
        "offset": course.offset,
        "laps": course.laps,
        "interventions": course.interventions,
        "expert_steering": expert_steering,
        "expert_throttle": expert_throttle,
    }
