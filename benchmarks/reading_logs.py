"""How fast logs are read back: `bc-log info`, `check` and `recover` on a log of a given size, and memory.

python benchmarks/reading_logs.py RECORDING [--gigabytes 1]

RECORDING is a folder of the Udacity simulator. Its pictures are written over and over, with the rows numbered on,
until the log has its size; everything is then read from the page cache, if that is large enough.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import Skipped
from common.car import CAMERAS
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.sources.udacity_recording import UdacityRecording

RUNS = 3
ROW_NS = 100_000_000


def write_long_log(recording: Path, path: Path, size_bytes: int) -> int:
    """A log of about `size_bytes`; how many messages it has."""
    found = [(row, paths) for row, paths in UdacityRecording(recording, Skipped()).rows() if all(paths)]
    rows = [row for row, _ in found[:200]]
    pictures = {Path(path).name: Path(path).read_bytes() for _, paths in found[:200] for path in paths if path}
    number = 0
    with LogWriter(path, {"source": "benchmark"}) as writer:
        while writer.bytes_written < size_bytes:
            row = rows[number % len(rows)]
            time_ns = row.time_ns + number * ROW_NS
            for camera, name in zip(CAMERAS, row.names, strict=True):
                writer.picture(camera, time_ns, number, pictures[name])
            state = VehicleState(
                steering=row.steering, throttle=row.throttle, brake=row.brake, speed_mph=row.speed_mph
            )
            writer.vehicle(time_ns, number, state)
            number += 1
    return number * (len(CAMERAS) + 1)


def timed(arguments: list[str], results: tuple[int, ...] = (0, 3)) -> tuple[float, float]:
    """Seconds of a `bc-log` command, start-up included, and the most memory that any took until now (MB)."""
    code = "from recorder.log_cli import main; main()"
    start_s = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - start_s
    if done.returncode not in results:
        sys.exit(f"bc-log {' '.join(arguments)}: {done.stderr}")
    return seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--gigabytes", type=float, default=1.0)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        log, copy = Path(folder) / "long.mcap", Path(folder) / "copy.mcap"
        messages = write_long_log(chosen.recording, log, int(chosen.gigabytes * 1e9))
        size_mb = log.stat().st_size / 1e6
        print(f"{size_mb:,.0f} MB, {messages:,} messages; {RUNS} runs each, median; start-up included")
        for name, arguments in (
            ("--help (start-up alone)", ["--help"]),
            ("info", ["info", str(log)]),
            ("check --no-look", ["check", "--no-look", str(log)]),
            ("check", ["check", str(log)]),
            ("recover", ["recover", str(log), "--to", str(copy), "--force"]),
        ):
            runs = [timed(arguments) for _ in range(RUNS)]
            seconds = statistics.median(run[0] for run in runs)
            print(
                f"{name:24} {seconds:8.2f} s {messages / seconds:12,.0f} messages/s {size_mb / seconds:8,.0f} MB/s"
                f"   at most {runs[-1][1]:,.0f} MB of memory"
            )


if __name__ == "__main__":
    main()
