"""How fast a real log is indexed, and the cost of ten million frames in 1,000 logs, locally or on a Ray cluster.

python benchmarks/indexing.py --log LOG
python benchmarks/indexing.py [--logs 1000] [--frames 10000000] [--ray local] [--folder FOLDER]

The 1,000 logs have tiny pictures (1.6 GB for ten million frames). --folder keeps them for the next run.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from common.car import CAMERAS
from common.ray_flag import tasks_of
from common.tasks import Tasks
from dataset import IndexConfig
from dataset.frames.frames_table import frames_table
from dataset.index import build
from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState

STEP_NS = 100_000_000
RUNS = 5


def index_log(path: Path) -> None:
    rates = []
    for _ in range(RUNS + 1):
        start_s = time.perf_counter()
        with Log(path) as log, tempfile.TemporaryDirectory() as name:
            frames = frames_table(log, Path(name), IndexConfig(), ())
        rates.append(len(frames) / (time.perf_counter() - start_s))
    rates = sorted(rates[1:])  # the first run reads the log from the disk
    size_mb = path.stat().st_size / 1e6
    print(
        f"indexing {len(frames):,} frames ({size_mb:,.0f} MB), every CRC checked: {statistics.median(rates):,.0f}"
        f" frames/s ({rates[0]:,.0f} to {rates[-1]:,.0f})"
    )


def write_log(folder: Path, rows: int, number: int) -> Path:
    """Write a log of a car with random steering, each on another day. The driver is "expert", because the index
    would look at the pictures of a person's drive."""
    path = folder / f"s{number:05d}.mcap"
    if path.exists():
        return path
    steering = np.clip(np.random.default_rng(number).laplace(0.0, 0.15, rows), -1, 1).tolist()
    picture = b"\xff\xd8\xff no picture is read here"
    with LogWriter(path, {"source": "benchmark", "driver": "expert"}) as writer:
        for row, value in enumerate(steering):
            time_ns = number * 10**14 + row * STEP_NS
            for camera in CAMERAS:
                writer.picture(camera, time_ns, row, picture)
            writer.vehicle(time_ns, row, VehicleState(steering=value, throttle=0.3, speed_mph=10.0))
    return path


class Costs:
    """Wall and processor seconds by part."""

    def __init__(self) -> None:
        self.wall_s: dict[str, float] = defaultdict(float)
        self.cpu_s: dict[str, float] = defaultdict(float)

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            try:
                return function(*arguments, **named)
            finally:
                self.wall_s[part] += time.perf_counter() - wall_s
                self.cpu_s[part] += time.process_time() - cpu_s

        return call

    def of_tasks(self, tasks: Tasks) -> Tasks:
        """Wrap `tasks` to add the processor time of the calls in their processes."""

        def counting(function: Callable[..., Any], calls: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Any]]:
            def call(*arguments: Any) -> tuple[Any, float]:
                cpu_s = time.process_time()
                result = function(*arguments)
                return result, time.process_time() - cpu_s

            wall_s, cpu_s = time.perf_counter(), time.process_time()
            part = f"tasks: {function.__name__.strip('_')}"
            for number, (result, spent_s) in tasks(call, calls):
                self.cpu_s[part] += spent_s
                yield number, result
            if calls:
                self.wall_s[part] += time.perf_counter() - wall_s
                self.cpu_s[f"the driver during {part}"] += time.process_time() - cpu_s

        return counting


def index(logs: Sequence[Path], folder: Path, ray: tuple[str, ...] | None) -> None:
    costs = Costs()
    for part, name in (
        ("the same pictures twice", "shared_standing_rows"),
        ("how each session was steered", "labels_of_sessions"),
        ("balance and samples", "write_samples"),
    ):
        setattr(build, name, costs.timed(part, getattr(build, name)))
    with tempfile.TemporaryDirectory(dir=folder) as name, tasks_of(ray) as tasks:
        if ray is not None:  # start the processes before the measurement
            list(tasks(_warm, [(number,) for number in range(4 * (os.cpu_count() or 1))]))
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        indexed = build.build_index(logs, Path(name), IndexConfig(), tasks=costs.of_tasks(tasks))
        wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
        frames = sum(count.frames for count in indexed.counts.values())
        size_mb = sum(file.stat().st_size for file in Path(name).rglob("*.parquet")) / 1e6
        million = frames / 1e6
        print(f"{frames:,} frames of {len(logs):,} logs, {'here' if ray is None else '--ray ' + ' '.join(ray)}:")
        for part, spent_s in costs.cpu_s.items():
            wall = f", {costs.wall_s[part]:.1f} s" if part in costs.wall_s else ""
            print(f"  {part}: {spent_s / million:.2f} CPU s a million frames ({spent_s:.1f} CPU s{wall})")
        print(
            f"  all: {wall_s:.1f} s; the driver {cpu_s:.1f} CPU s and at most {_peak_mb():,.0f} MB;"
            f" {size_mb:,.0f} MB of index (load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors)"
        )
        start_s = time.perf_counter()
        build.build_index(logs, Path(name), IndexConfig())
        print(f"  again, with no log changed: {time.perf_counter() - start_s:.2f} s")


def _warm(number: int) -> int:
    return number


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--log", type=Path, help="instead, index this real log several times")
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--frames", type=int, default=10_000_000)
    parser.add_argument("--ray", nargs="?", const="")
    parser.add_argument("--folder", type=Path)
    chosen = parser.parse_args()
    if chosen.log:
        index_log(chosen.log)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = chosen.folder or Path(name)
        write = partial(write_log, folder / "sessions", chosen.frames // len(CAMERAS) // chosen.logs)
        with ProcessPoolExecutor() as pool:
            logs = list(pool.map(write, range(chosen.logs), chunksize=10))
        ray = None if chosen.ray is None else (chosen.ray,) if chosen.ray else ()
        index(logs, folder, ray)


if __name__ == "__main__":
    main()
