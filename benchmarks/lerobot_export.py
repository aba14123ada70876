"""How fast logs become a LeRobot dataset, on one core, and how much memory it takes.

taskset -c 0 python benchmarks/lerobot_export.py LOG
"""

from __future__ import annotations

import re
import shutil
import statistics
import sys
import tempfile
import threading
import time
from pathlib import Path

from common.car import CAMERAS
from recorder import Log, LogWriter
from recorder.lerobot.export import export_lerobot
from recorder.log.topics import camera_topic

FRAMES = (1_000, 10_000)
RUNS = 3
ROWS_A_DRIVE = 1_000
PAUSE_NS = 5_000_000_000


def main() -> None:
    """Print pictures/s (median, least to most, of several runs; the disk's share is in them) and memory."""
    if len(sys.argv) != 2:
        raise SystemExit("usage: python benchmarks/lerobot_export.py LOG (its pictures are repeated)")
    with tempfile.TemporaryDirectory() as name:
        for frames in FRAMES:
            for rows_a_drive in sorted({ROWS_A_DRIVE, frames}):
                log = _repeated(
                    Path(sys.argv[1]), Path(name) / f"{frames}-{rows_a_drive}.mcap", frames, rows_a_drive
                )
                runs = [_run(log, Path(name) / f"out-{run}") for run in range(RUNS)]
                rates, cpu_rates, memory_mb = zip(*runs, strict=True)
                print(
                    f"{frames:,} frames in drives of {rows_a_drive:,}: {_spread(rates)} pictures/s,"
                    f" {statistics.median(cpu_rates):,.0f} a CPU second; memory {max(memory_mb):,.0f} MB"
                )
                log.unlink()


def _repeated(source: Path, path: Path, frames: int, rows_a_drive: int) -> Path:
    with Log(source) as log, LogWriter(path, {"source": "benchmark"}) as writer:
        states = list(log.vehicle_states())
        pictures = {camera: log.pictures(camera_topic(camera)) for camera in CAMERAS}
        first_ns = states[0][0].log_time_ns
        for row in range(frames):
            at = row % len(states)
            time_ns = first_ns + 100_000_000 * row + PAUSE_NS * (row // rows_a_drive)
            for camera, found in pictures.items():
                place = int(found.offset[at]), int(found.length[at]), int(found.chunk[at])
                writer.picture(camera, time_ns, row, log.read(*place))
            writer.vehicle(time_ns, row, states[at][1])
    return path


def _run(log: Path, folder: Path) -> tuple[float, float, float]:
    """Pictures a second, pictures a CPU second, and the most memory (MB) beside what was taken before."""
    peaks, before_mb, has_ended = [0.0], _anonymous_mb(), threading.Event()

    def watch() -> None:
        while not has_ended.wait(0.02):
            peaks.append(_anonymous_mb())

    watcher = threading.Thread(target=watch)
    watcher.start()
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    done = export_lerobot([log], folder)
    seconds, cpu_seconds = time.perf_counter() - start_s, time.process_time() - start_cpu_s
    has_ended.set()
    watcher.join()
    shutil.rmtree(folder)
    return done.pictures / seconds, done.pictures / cpu_seconds, max(peaks) - before_mb


def _anonymous_mb() -> float:
    """Memory of this process that is no file's (Linux)."""
    match = re.search(r"RssAnon:\s+(\d+) kB", Path("/proc/self/status").read_text(encoding="ascii"))
    return int(match[1]) / 1024 if match else 0.0


def _spread(values: tuple[float, ...]) -> str:
    return f"{statistics.median(values):,.0f} ({min(values):,.0f} to {max(values):,.0f})"


if __name__ == "__main__":
    main()
