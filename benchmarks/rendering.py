"""How fast the built-in simulator renders and builds its tracks, alone and as a Gymnasium environment.

python benchmarks/rendering.py

All measurements are processor time on one core, one after the other. The environment holds the same commands for
0.1 s and takes the same pictures as the simulator alone. It adds the conversion to RGB, the observation, the info,
and Gymnasium's own wrappers.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from typing import Any

import cv2
import gymnasium
import numpy as np

from common.car import CAMERAS, Camera
from simulator.driving.simulation import Simulation
from simulator.environment import RATE_HZ
from simulator.pose import Pose
from simulator.rendering.camera import Renderer
from simulator.rendering.world_maps import WorldMaps, build_world
from simulator.roads.track import Track, load_track

RUNS, STEPS = 7, 60
ACTION = np.array([0.0, 0.1], np.float32)

Drive = Callable[[], None]


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["BC_CACHE"] = folder
        for name in ("lake", "mountain", "random:7"):
            print_track(name)
        for cameras in (("center",), CAMERAS):
            print_environment(cameras)


def print_track(name: str) -> None:
    """Print the steps per second of three cameras, and the time to build the track."""
    track = load_track(name)
    times = []
    for _ in range(2):  # the first call builds and writes the world, the second reads it
        start_s = time.process_time()
        world = build_world(track)
        times.append(time.process_time() - start_s)
    rates = [_steps_per_s(track, world) for _ in range(RUNS)]
    print(
        f"{name:9} {statistics.median(rates):5.1f} steps/s of three cameras"
        f" ({min(rates):.1f} to {max(rates):.1f}), built in {times[0]:.2f} s, read back in {times[1]:.2f} s"
    )


def _steps_per_s(track: Track, world: WorldMaps) -> float:
    renderer = Renderer(world)
    places = [track.line.at(arc) for arc in np.linspace(0.0, track.line.length_m, STEPS, endpoint=False)]
    poses = [Pose(p.x_m, p.y_m, p.z_m, p.heading_rad, float(np.arctan(p.slope))) for p in places]
    start_s = time.process_time()
    for pose in poses:
        for camera in CAMERAS:
            renderer.render(pose, camera)
    return STEPS / (time.process_time() - start_s)


def print_environment(cameras: tuple[Camera, ...]) -> None:
    """Print the steps per second of CPU time: the median of the rounds, and the ratio to the simulator alone."""
    drives: dict[str, Drive] = {
        "the simulator alone": alone(cameras),
        "the environment": stepped(gymnasium.make("simulator:bc/Lake-v0", cameras=cameras).unwrapped),
        "gymnasium.make": stepped(gymnasium.make("simulator:bc/Lake-v0", cameras=cameras)),
    }
    rates: dict[str, list[float]] = {name: [] for name in drives}
    for _ in range(RUNS):
        for name, drive in drives.items():
            start_s = time.process_time()
            drive()
            rates[name].append(STEPS / (time.process_time() - start_s))
    reference = rates["the simulator alone"]
    for name, measured in rates.items():
        ratio = statistics.median(rate / alone_rate for rate, alone_rate in zip(measured, reference, strict=True))
        print(f"{len(cameras)} cameras, {name:19} {statistics.median(measured):6.1f} steps/s, {ratio:.3f}")


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
