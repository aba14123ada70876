"""Autonomous mode: the built-in simulator connects to a server, as Udacity's simulator does.

Simulated time stops until an answer comes, so that a drive depends only on the answers, and not on the speed of
the machine. As with Udacity's simulator, two telemetries are in flight: a command is for the picture one step
before. So after a takeover by the expert, one more command of the network comes before the expert's first.
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

# An expert who takes over at full lock brings the car back to the road, and a metre farther, within 10 s. During
# this time the course reports that the car is stuck, because only progress on the road counts.
RECOVERY_LIMIT_S = 10.0

GIVE_UP_S = 60.0
"""If the car makes less than a metre of progress in this time, also after it was put back, the drive ends."""


@dataclass(frozen=True)
class AutonomousDrive:
    track: str
    whole_laps: int
    measures: CourseMeasures
    gave_up: bool  # the drive ended before all laps were driven: see `GIVE_UP_S`
    unreadable: int  # number of commands that were not numbers
    trajectory_sha256: str  # of all poses: equal if two drives took the same path

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
    """Drive `laps` from `start_m` along the track, with `rate_hz` telemetries a second of simulated time.
    `rate_hz` must divide 50.

    If the car leaves the road or is stuck, it is put back on the centre line, which counts as an intervention.
    With `leave_off_road`, this happens only after it was stuck for `RECOVERY_LIMIT_S`, because the driver may
    bring it back. A command can also request it. The drive ends if the car makes no progress for `GIVE_UP_S`.

    With `real_time`, simulated time is not faster than the clock. With `expert`, each telemetry also has the
    world, and the expert's command for the picture. `progress` is called with the number of laps so far. `lost` is
    called when the server has gone; the simulator then waits for a server.

    Raises WaitTimeoutError if no server answers.
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
            if real_time:
                # lost time is not made up after a delay: a person could not steer a car that runs faster
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
        # as in Udacity's simulator, the telemetry does not show braking
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
