"""A network drives a Gymnasium environment, which waits for each answer."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Final

from common.interrupts import StopEvent
from drive.config import DriveError
from drive.drive_session import DriveSession
from recorder.server.telemetry import Telemetry
from recorder.server.world import World
from recorder.sources.gymnasium_car import CarCommand, GymnasiumCar

EPISODES_METADATA: Final = "bc.gymnasium"


@dataclass(frozen=True)
class Episode:
    seed: int
    steps: int
    reward: float
    end: str  # "terminated", "truncated", or "stopped" by a person


def check_pedals(car: GymnasiumCar) -> None:
    if car.actions.has_pedals and not (car.has_speed or car.has_expert):
        raise DriveError(
            f"action {car.actions.text}: the network only steers; for the pedals give the environment's key"
            " of the speed (the toolkit then holds --speed), or --expert MODULE:FUNCTION, or constants in the"
            " action (steering,0.1,0)"
        )


def drive_gymnasium(
    session: DriveSession, car: GymnasiumCar, seed: int, episodes: int, stopped: StopEvent
) -> Iterator[Episode]:
    """Drive episodes with the seeds `seed`, `seed` + 1 and so on. Yields each episode when it ends. If the log
    cannot be written, the drive ends.

    The network steers. If the environment gives the speed, the speed controller works the pedals; else the expert
    does, if there is one.
    """

    def is_over() -> bool:
        return stopped.is_set() or session.log.failure is not None

    driven = []
    for number in range(episodes):
        if is_over():
            break
        session.connected()
        moment = car.reset(seed + number)
        command, steps, reward = CarCommand(0.0), 0, 0.0
        while not (moment.end or is_over()):
            expert = car.expert_command(moment) if car.has_expert else None
            received_s = time.perf_counter()
            telemetry = Telemetry(
                steering=command.steering,
                throttle=command.throttle,
                speed_mph=moment.speed_mph,
                picture=moment.jpeg(),
                world=World(
                    time_s=steps / car.rate_hz,
                    expert_steering=None if expert is None else expert.steering,
                    expert_throttle=None if expert is None else expert.throttle - expert.brake,
                ),
            )
            answer = session.telemetry(telemetry, received_s)
            assert answer.command is not None  # noqa: S101
            throttle = answer.command.throttle
            command = CarCommand(answer.command.steering, max(0.0, throttle), max(0.0, -throttle))
            answer.on_sent((time.perf_counter() - received_s) * 1e3)
            moment = car.step(car.actions.action(command))
            steps, reward = steps + 1, reward + moment.reward
        driven.append(Episode(seed + number, steps, reward, moment.end or "stopped"))
        session.disconnected(f"episode {number + 1}, seed {seed + number}: {driven[-1].end}, reward {reward:,.1f}")
        session.add_metadata(EPISODES_METADATA, {"episodes": json.dumps([asdict(episode) for episode in driven])})
        yield driven[-1]


def mean_reward(episodes: list[Episode]) -> float:
    """The mean reward of the episodes that were not stopped; NaN if there are none."""
    ended = [episode.reward for episode in episodes if episode.end != "stopped"]
    return sum(ended) / len(ended) if ended else math.nan
