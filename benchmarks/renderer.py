"""How fast the built-in simulator renders, and how long its tracks take to build: one core, three cameras a
step.

python benchmarks/renderer.py
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time

import cv2
import numpy as np

from common.car import CAMERAS
from simulator.pose import Pose
from simulator.rendering.camera import Renderer
from simulator.rendering.world_maps import WorldMaps, build_world
from simulator.roads.track import Track, load_track

RUNS, STEPS = 5, 60


def main() -> None:
    """Print steps a second (median of several runs) and building times for three tracks."""
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["BC_CACHE"] = folder
        for name in ("lake", "mountain", "random:7"):
            track = load_track(name)
            times = []
            for _ in range(2):  # the first call bakes and writes, the second reads
                start = time.perf_counter()
                world = build_world(track)
                times.append(time.perf_counter() - start)
            rates = [_steps_per_s(track, world) for _ in range(RUNS)]
            print(
                f"{name:9} {statistics.median(rates):5.1f} steps/s of three cameras "
                f"({min(rates):.1f} to {max(rates):.1f}),"
                f" built in {times[0]:.2f} s, read back in {times[1]:.2f} s"
            )


def _steps_per_s(track: Track, world: WorldMaps) -> float:
    renderer = Renderer(world)
    places = [track.line.at(arc) for arc in np.linspace(0.0, track.line.length_m, STEPS, endpoint=False)]
    poses = [Pose(p.x_m, p.y_m, p.z_m, p.heading_rad, float(np.arctan(p.slope))) for p in places]
    start = time.perf_counter()
    for pose in poses:
        for camera in CAMERAS:
            renderer.render(pose, camera)
    return STEPS / (time.perf_counter() - start)


if __name__ == "__main__":
    main()
