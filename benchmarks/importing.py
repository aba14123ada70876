"""How fast a Udacity recording becomes a log, on one core.

taskset -c 0 python benchmarks/importing.py FOLDER
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from common import Skipped
from recorder import import_udacity
from recorder.pictures.jpeg import is_whole_jpeg
from recorder.sources.udacity_recording import UdacityRecording

RUNS = 7


def main() -> None:
    """Print pictures/s (median, least to most, of several runs; the disk's share is in them) and its parts."""
    if len(sys.argv) != 2:
        raise SystemExit("usage: python benchmarks/importing.py FOLDER (it holds driving_log.csv and IMG/)")
    folder = Path(sys.argv[1])
    rates = [_import_per_s(folder) for _ in range(RUNS + 1)][1:]  # the first reads the pictures from the disk
    print(f"import  {_spread(rates)} pictures/s")

    jpegs = [Path(path).read_bytes() for path in _pictures(folder)]
    read = [_seconds(lambda: _pictures(folder)) / len(jpegs) for _ in range(RUNS)]
    print(f"  reading the csv and finding the pictures: {_spread([1e6 * s for s in read])} us a picture")
    checks = [_seconds(lambda: [is_whole_jpeg(jpeg) for jpeg in jpegs]) / len(jpegs) for _ in range(RUNS)]
    print(f"  telling that it is whole: {_spread([1e6 * s for s in checks])} us a picture")


def _pictures(folder: Path) -> list[str]:
    return [path for _, paths in UdacityRecording(folder, Skipped()).rows() for path in paths if path is not None]


def _import_per_s(folder: Path) -> float:
    with tempfile.TemporaryDirectory() as name:
        start = time.perf_counter()
        done = import_udacity(folder, Path(name) / "log.mcap")
        return done.pictures / (time.perf_counter() - start)


def _seconds(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def _spread(values: list[float]) -> str:
    return f"{statistics.median(values):,.1f} ({min(values):,.1f} to {max(values):,.1f})"


if __name__ == "__main__":
    main()
