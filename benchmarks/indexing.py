"""How fast logs are indexed, and what an index of ten million frames costs.

python benchmarks/indexing.py LOG [--frames 10000000] [--sessions 1000]

LOG is a real log. The ten million frames are made up (times, steering, and places in logs that do not exist),
because nothing of this stage reads a picture.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from common.car import CAMERAS, Camera
from dataset import IndexConfig, build_index
from dataset.frames.frames_file import extent_of
from dataset.frames.frames_table import frames_of, frames_table
from dataset.index.build_state import BuiltLog
from dataset.index.duplicates import shared_standing_rows
from dataset.index.session_labels import labels_of_sessions
from dataset.parquet_file import write_table
from dataset.samples.samples_writer import write_samples
from recorder import Log, LogWriter, Pictures
from recorder.bc_pb2 import VehicleState
from recorder.log.row_quality import States

RUNS = 5
STEP_NS = 100_000_000


def index_log(path: Path, name: str) -> None:
    rates = []
    for _ in range(RUNS + 1):
        start_s = time.perf_counter()
        with Log(path) as log:
            frames = frames_table(log, Path(name), IndexConfig(), ())
        rates.append(len(frames) / (time.perf_counter() - start_s))
    rates = sorted(rates[1:])  # the first reads the log from the disk
    size_mb = path.stat().st_size / 1e6
    median = statistics.median(rates)
    print(
        f"indexing {len(frames):,} frames ({size_mb:,.0f} MB), every CRC checked: {median:,.0f} frames/s"
        f" ({rates[0]:,.0f} to {rates[-1]:,.0f}); {median * size_mb / len(frames):,.0f} MB/s"
    )


def unchanged_sessions(folder: Path, sessions: int) -> None:
    logs = []
    for number in range(sessions):
        path = folder / f"s{number:04d}.mcap"
        with LogWriter(path, {"source": "benchmark"}) as writer:
            for row in range(3):
                for camera in CAMERAS:
                    writer.picture(camera, row * STEP_NS, row, f"{number} {camera} {row}".encode())
                writer.vehicle(row * STEP_NS, row, VehicleState(steering=0.1 * row))
        logs.append(path)
    seconds = []
    for _ in range(2):
        start_s = time.perf_counter()
        build_index(logs, folder / "index")
        seconds.append(time.perf_counter() - start_s)
    print(f"{sessions:,} sessions: indexed in {seconds[0]:.2f} s, unchanged in {seconds[1]:.2f} s")


def made_up(session: int, rows: int) -> tuple[States, dict[Camera, Pictures]]:
    """A session of a car that winds along: mostly nearly straight, sometimes not."""
    random = np.random.default_rng(session)
    row = np.arange(rows)
    time_ns = session * 10**13 + row * STEP_NS
    steering = np.clip(random.laplace(0.0, 0.15, rows), -1, 1)
    ones = np.ones(rows)
    states = States(row, time_ns, steering, 0.3 * ones, 0.0 * ones, 10 * ones)
    length = random.integers(9_000, 15_000, (len(CAMERAS), rows))
    offset = np.cumsum(length.T.ravel()).reshape(rows, len(CAMERAS)).T
    places = {
        camera: Pictures(row, time_ns, offset[i], length[i], np.full(rows, -1)) for i, camera in enumerate(CAMERAS)
    }
    return states, places


def scale(folder: Path, frames: int, sessions: int) -> None:
    config = IndexConfig()
    rows = frames // len(CAMERAS) // sessions
    split_s = 0.0
    files: dict[str, Path] = {}
    for number in range(sessions):
        states, places = made_up(number, rows)
        start_s = time.perf_counter()
        table = frames_of(states, places, f"s{number:04d}", config)
        split_s += time.perf_counter() - start_s
        files[f"s{number:04d}"] = folder / f"s{number:04d}.parquet"
        write_table(files[f"s{number:04d}"], table, {})
    start_s = time.perf_counter()
    shared_standing_rows(files, files, {name: extent_of(file) for name, file in files.items()})
    shared_s = time.perf_counter() - start_s
    start_s = time.perf_counter()
    built = {name: BuiltLog(("", None, None, None), driven_by="nobody") for name in files}
    labels = labels_of_sessions(files, files, built, folder, config)
    balance, _ = write_samples(files, folder / "samples.parquet", config, {}, labels)
    balance_s = time.perf_counter() - start_s
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    total = rows * sessions * len(CAMERAS)
    print(
        f"{total:,} frames: bins, blocks and split {split_s:.1f} s; no picture twice {shared_s:.1f} s;"
        f" {balance.after.sum():,} balanced samples {balance_s:.1f} s; at most {memory_mb:,.0f} MB of memory"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--frames", type=int, default=10_000_000)
    parser.add_argument("--sessions", type=int, default=1000)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        index_log(chosen.log, name)
        unchanged_sessions(Path(name), chosen.sessions)
    for frames in (chosen.frames // 10, chosen.frames):  # the memory is that of the largest until then
        with tempfile.TemporaryDirectory() as name:
            scale(Path(name), frames, chosen.sessions)
            shutil.rmtree(name, ignore_errors=True)


if __name__ == "__main__":
    main()
