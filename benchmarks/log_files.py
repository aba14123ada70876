"""Speed and memory of importing a recording, reading a log, and exporting a log as a LeRobot dataset.

taskset -c 0 python benchmarks/log_files.py RECORDING [--gigabytes 1]

RECORDING is a folder of Udacity's simulator. It is imported. Then its pictures are written repeatedly, with
consecutive row numbers, until the log has the wanted size. Everything is read from the page cache, if that is
large enough.
"""

from __future__ import annotations

import argparse
import re
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from common.car import CAMERAS
from recorder import LogWriter, import_udacity
from recorder.lerobot.export import export_lerobot
from recorder.sources.clean import names_of, state_of
from recorder.sources.udacity_recording import read_udacity

RUNS = 3
ROW_NS = 100_000_000
DRIVE_ROWS = 1_000
PAUSE_NS = 5_000_000_000
EXPORTED_ROWS = 10_000


def print_import(recording: Path, folder: Path) -> None:
    """Print the pictures per second of an import, including the time of the disk."""
    rates = []
    for run in range(RUNS + 1):
        start_s = time.perf_counter()
        imported = import_udacity(recording, folder / f"{run}.mcap")
        rates.append(imported.pictures / (time.perf_counter() - start_s))
    print(f"import: {_spread(rates[1:])} pictures/s")  # the first run reads the pictures from the disk


def write_long_log(recording: Path, path: Path, size_bytes: float, max_rows: float = float("inf")) -> int:
    """Write a log of about `size_bytes` in drives of 1,000 rows. Returns its number of messages."""
    raw = read_udacity(recording)
    folder = raw.folder
    complete = [
        (row, paths)
        for row in raw.rows
        if not row.problem
        and folder is not None
        and len(paths := [found for name in names_of(row) if (found := folder.find(name))]) == len(CAMERAS)
    ][:200]
    number = 0
    with LogWriter(path, {"source": "benchmark"}) as writer:
        while writer.bytes_written < size_bytes and number < max_rows:
            row, paths = complete[number % len(complete)]
            time_ns = int(row.time or 0) + number * ROW_NS + number // DRIVE_ROWS * PAUSE_NS
            for camera, picture in zip(CAMERAS, paths, strict=True):
                writer.picture(camera, time_ns, number, Path(picture).read_bytes())
            writer.vehicle(time_ns, number, state_of(row))
            number += 1
    return number * (len(CAMERAS) + 1)


def print_reading(log: Path, messages: int) -> None:
    """Print the times of `bc-log info`, `check` and `recover`, including start-up."""
    size_mb = log.stat().st_size / 1e6
    print(f"{size_mb:,.0f} MB, {messages:,} messages; {RUNS} runs each, median; start-up included")
    for name, arguments in (
        ("--help (start-up alone)", ["--help"]),
        ("info", ["info", str(log)]),
        ("check --no-look", ["check", "--no-look", str(log)]),
        ("check", ["check", str(log)]),
        ("recover", ["recover", str(log), "--to", str(log.with_name("copy.mcap")), "--force"]),
    ):
        runs = [timed(arguments) for _ in range(RUNS)]
        seconds = statistics.median(run[0] for run in runs)
        print(
            f"{name:24} {seconds:8.2f} s {messages / seconds:12,.0f} messages/s {size_mb / seconds:8,.0f} MB/s"
            f"   at most {runs[-1][1]:,.0f} MB of memory"
        )


def timed(arguments: list[str]) -> tuple[float, float]:
    """The seconds of a `bc-log` command, and the peak memory in MB of all commands until now."""
    code = "from recorder.log_cli import main; main()"
    start_s = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - start_s
    if done.returncode not in (0, 3):
        sys.exit(f"bc-log {' '.join(arguments)}: {done.stderr}")
    return seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024


def print_export(log: Path, folder: Path) -> None:
    """Print the pictures per second and per CPU second of an export, and its memory in MB above that before it."""
    runs = [_export(log, folder) for _ in range(RUNS)]
    rates, cpu_rates, memory_mb = zip(*runs, strict=True)
    cpu_rate = statistics.median(cpu_rates)
    print(f"LeRobot: {_spread(rates)} pictures/s, {cpu_rate:,.0f} a CPU second; memory {max(memory_mb):,.0f} MB")


def _export(log: Path, folder: Path) -> tuple[float, float, float]:
    peaks, before_mb, has_ended = [0.0], _anonymous_mb(), threading.Event()

    def watch() -> None:
        while not has_ended.wait(0.02):
            peaks.append(_anonymous_mb())

    watcher = threading.Thread(target=watch)
    watcher.start()
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    exported = export_lerobot([log], folder)
    seconds, cpu_seconds = time.perf_counter() - start_s, time.process_time() - start_cpu_s
    has_ended.set()
    watcher.join()
    shutil.rmtree(folder)
    return exported.pictures / seconds, exported.pictures / cpu_seconds, max(peaks) - before_mb


def _anonymous_mb() -> float:
    """Anonymous memory of this process in MB, without mapped files (Linux)."""
    match = re.search(r"RssAnon:\s+(\d+) kB", Path("/proc/self/status").read_text(encoding="ascii"))
    return int(match[1]) / 1024 if match else 0.0


def _spread(values: list[float] | tuple[float, ...]) -> str:
    return f"{statistics.median(values):,.0f} ({min(values):,.0f} to {max(values):,.0f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--gigabytes", type=float, default=1.0)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print_import(chosen.recording, folder)
        messages = write_long_log(chosen.recording, folder / "long.mcap", 1e9 * chosen.gigabytes)
        print_reading(folder / "long.mcap", messages)
        write_long_log(chosen.recording, folder / "exported.mcap", float("inf"), EXPORTED_ROWS)
        print_export(folder / "exported.mcap", folder / "lerobot")


if __name__ == "__main__":
    main()
