"""An hour of driving at 60 frames a second, as fast as it goes: does memory stay flat, and is the log whole?

python benchmarks/driving_hour.py RUN --recording lake_windows [--minutes 60] [--folder FOLDER] [flags of bc-drive]

`bc-drive` is told 216,000 pictures, one at a time, as in driving_replies.py; flags it does not have itself are
handed to it (`--viewer hour.rrd`, `--server threading`). Its memory is read every second. Afterwards the CRC of
every chunk of the log is compared and the rows are counted. A frame takes about 50 KB of the log, the hour 10 GB.
"""

from __future__ import annotations

import argparse
import signal
import statistics
import sys
import tempfile
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import numpy as np
import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
from driving_servers import Server, Turn, start_ours, write_pictures

from recorder import Log
from recorder.log import topics
from recorder.log.topics import camera_topic

RATE_HZ: Final = 60
SAMPLE_S: Final = 1.0


class MemorySampler:
    """Reads the resident memory of a server, and of what it has started, until the block ends; in MB."""

    def __init__(self, server: Server) -> None:
        self.server_mb: list[float] = []
        self.started_mb: list[float] = []
        self._server = server
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._sample)

    def __enter__(self) -> MemorySampler:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()

    def _sample(self) -> None:
        while not self._is_over.wait(SAMPLE_S):
            self.server_mb.append(_resident_mb(self._server.process))
            self.started_mb.append(sum(_resident_mb(child) for child in self._server.started()))


def _resident_mb(process: psutil.Process) -> float:
    try:
        return float(process.memory_info().rss) / 1e6
    except psutil.NoSuchProcess:
        return 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="the folder of a run")
    parser.add_argument("--recording", type=Path, help="a folder of the Udacity simulator, or a log")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--folder", type=Path, help="where the log is kept; without, it is removed in the end")
    chosen, flags = parser.parse_known_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # else the servers would outlive us, suspended
    frames = round(chosen.minutes * 60 * RATE_HZ)
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        pictures = Path(name) / "pictures"
        pictures.mkdir()
        write_pictures(chosen.recording, pictures)
        log = (chosen.folder or Path(name)) / "hour.mcap"
        server = start_ours("bc-drive", chosen.run, log, stack, *flags)
        with MemorySampler(server) as memory:
            turn = server.drive(pictures, frames, float("inf"))
        code = server.end()
        print(f"{frames:,} telemetries in {turn.seconds:,.0f} s, {turn.replies_per_s:,.0f} replies/s")
        print_tenths(memory, turn)
        print(f"exit code {code}, log of {log.stat().st_size / 1e9:.2f} GB")
        is_whole = print_rows(log, frames)
        if code != 0 or not is_whole:
            raise SystemExit(f"something was lost\n{server.said()}")


def print_tenths(memory: MemorySampler, turn: Turn) -> None:
    """What the first and the last tenth of the drive were like."""
    print("\n| | first tenth | last tenth | most |\n|---|---|---|---|")
    for what, values, unit in (
        ("memory of `bc-drive`", memory.server_mb, "MB"),
        ("memory of what it has started", memory.started_mb, "MB"),
    ):
        tenth = max(1, len(values) // 10)
        first, last = statistics.mean(values[:tenth]), statistics.mean(values[-tenth:])
        print(f"| {what} | {first:,.1f} {unit} | {last:,.1f} {unit} | {max(values):,.1f} {unit} |")
    trips = turn.round_trips_ms
    tenth = max(1, len(trips) // 10)
    for percent in (50, 99):
        first, last = (float(np.percentile(part, percent)) for part in (trips[:tenth], trips[-tenth:]))
        print(f"| round trip, p{percent} | {first:.2f} ms | {last:.2f} ms | {max(trips):.2f} ms |")
    print()


def print_rows(path: Path, frames: int) -> bool:
    """Count the rows of each topic; whether each has every frame, once and in order. Every CRC is compared."""
    is_whole = True
    with Log(path) as log:
        for topic in (camera_topic("center"), topics.PILOT_INPUT, topics.VEHICLE, topics.PILOT_COMMAND):
            rows = [message.sequence for message in log.messages(topic)]
            print(f"{topic}: {len(rows):,} of {frames:,} rows")
            is_whole &= rows == list(range(frames))
    return is_whole


if __name__ == "__main__":
    main()
