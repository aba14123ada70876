"""A run in CarRacing-v3, compared with its expert, on tracks that were not recorded: visited tiles and reward.

python studies/car_racing.py runs/racer

docs/gymnasium.md shows how to record, train and drive the run. In one drive the network steers, in the other the
expert; the expert works the pedals in both.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from drive.config import DriveConfig
from drive.control.driver import Driver
from model import Pilot, load_pilot
from recorder.server.telemetry import Telemetry
from recorder.server.world import World
from recorder.sources.gymnasium_car import CarCommand, GymnasiumCar
from recorder.sources.settings import GymFlags

FIRST_SEED, TRACKS = 1000, 10
EXPERT = Path(__file__).parents[1] / "examples" / "car_racing_expert.py"


def main() -> None:
    """Print a line for each track, and the mean."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    pilot = load_pilot(parser.parse_args().run)
    pilot.warm_up()
    flags = GymFlags(str(EXPERT.with_name("car_racing.toml")), expert=f"{EXPERT}:drive")
    rows = []
    print("| track | tiles | network's | reward | expert's | reward |")
    print("|---|---|---|---|---|---|", flush=True)
    with GymnasiumCar(flags) as car:
        for seed in range(FIRST_SEED, FIRST_SEED + TRACKS):
            rows.append((*episode(car, seed, pilot), *episode(car, seed)))
            tiles, visited, reward, _, expert_visited, expert_reward = rows[-1]
            line = f"{visited} | {reward:.0f} | {expert_visited} | {expert_reward:.0f}"
            print(f"| {seed} | {tiles} | {line} |", flush=True)
    means = [sum(column) / len(rows) for column in zip(*rows, strict=True)]
    share, expert_share = means[1] / means[0], means[4] / means[3]
    print(f"| mean | | {100 * share:.1f} % | {means[2]:.0f} | {100 * expert_share:.1f} % | {means[5]:.0f} |")


def episode(car: GymnasiumCar, seed: int, pilot: Pilot | None = None) -> tuple[int, int, float]:
    """Drive with the pilot's steering, or without a pilot with the expert's. Returns the number of tiles of the
    track, the number of visited tiles, and the reward."""
    moment, reward, steps = car.reset(seed), 0.0, 0
    driver = None if pilot is None else Driver(pilot, DriveConfig())
    while not moment.end:
        command = car.expert_command(moment)
        if driver is not None:
            world = World(
                time_s=steps / car.rate_hz,
                expert_steering=command.steering,
                expert_throttle=command.throttle - command.brake,
            )
            telemetry = Telemetry(0.0, 0.0, moment.speed_mph, moment.jpeg(), world=world)
            decision = driver.decide(telemetry, 0.0)
            command = CarCommand(decision.steering, max(0.0, decision.throttle), max(0.0, -decision.throttle))
        moment = car.step(car.actions.action(command))
        reward, steps = reward + moment.reward, steps + 1
    racing = car.env.unwrapped
    return len(racing.track), racing.tile_visited_count, reward  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()
