"""How fast the built-in simulator is as a Gymnasium environment, beside the same simulator alone.

Both hold the same commands for 0.1 s and take the same pictures; what the environment adds is RGB in place of BGR,
the observation, the info, and Gymnasium's own wrappers. Each round runs all of them, one after the other.

python benchmarks/gymnasium_steps.py
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import cv2
import gymnasium
import numpy as np

from common.car import CAMERAS, Camera
from simulator.driving.simulation import Simulation
from simulator.environment import RATE_HZ

ROUNDS, STEPS = 7, 60
ACTION = np.array([0.0, 0.1], np.float32)

Drive = Callable[[], None]


def main() -> None:
    """Print steps a second of CPU time: the median of the rounds, and the ratio to the simulator alone."""
    cv2.setNumThreads(1)
    for cameras in (("center",), CAMERAS):
        drives: dict[str, Drive] = {
            "the simulator alone": alone(cameras),
            "the environment": stepped(gymnasium.make("simulator:bc/Lake-v0", cameras=cameras).unwrapped),
            "gymnasium.make": stepped(gymnasium.make("simulator:bc/Lake-v0", cameras=cameras)),
        }
        rates: dict[str, list[float]] = {name: [] for name in drives}
        for _ in range(ROUNDS):
            for name, drive in drives.items():
                start_s = time.process_time()
                drive()
                rates[name].append(STEPS / (time.process_time() - start_s))
        reference = rates["the simulator alone"]
        for name, found in rates.items():
            ratio = statistics.median(rate / one for rate, one in zip(found, reference, strict=True))
            print(f"{len(cameras)} cameras, {name:19} {statistics.median(found):6.1f} steps/s, {ratio:.3f}")


def alone(cameras: tuple[Camera, ...]) -> Drive:
    simulation = Simulation("lake")

    def drive() -> None:
        simulation.course.start()
        for camera in cameras:
            simulation.picture(camera)
        for _ in range(STEPS):
            simulation.course.advance(0.0, 0.1, 1 / RATE_HZ)
            for camera in cameras:
                simulation.picture(camera)

    return drive


def stepped(env: gymnasium.Env[Any, Any]) -> Drive:
    def drive() -> None:
        env.reset(options={"start_m": 0.0})
        for _ in range(STEPS):
            env.step(ACTION)

    return drive


if __name__ == "__main__":
    main()
