"""Replies a second and round trips of driving.

python benchmarks/driving_replies.py RUN --recording lake_windows

The client is `simulator/protocol/client.py`, which has the real simulator's wire behaviour, with one telemetry in
flight; it and each server are processes of their own. A turn is a connection; the turns go round, and who waits
for one is suspended with all that it has started. The first round warms up and is not counted. All drive with the
network of RUN. Without --recording, the pictures are those of the built-in simulator.
The second table is what `bc-drive` wrote down of itself in its log.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import numpy as np
from driving_servers import Server, start_ours, write_pictures

from recorder import Log

WARM_UP: Final = 50  # telemetries
STAGES: Final = ("parse_ms", "decode_ms", "network_ms", "total_ms")


VIEWER: Final = ("--viewer",)  # one that writes a file
OURS: Final = {
    "`bc-drive`": (),
    "`bc-drive --viewer`": VIEWER,
    "`bc-drive --precision float32`": ("--precision", "float32"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="the folder of a run")
    parser.add_argument("--recording", type=Path, help="a folder of the Udacity simulator, or a log")
    parser.add_argument("--frames", type=int, default=10_000, help="telemetries for each, in all rounds together")
    parser.add_argument("--rounds", type=int, default=5, help="turns that count")
    parser.add_argument("--turn-seconds", type=float, default=30.0, help="the most that a turn takes")
    chosen = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # else the servers would outlive us, suspended
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        (folder / "pictures").mkdir()
        write_pictures(chosen.recording, folder / "pictures")
        servers = [start_contender(ours, chosen.run, folder, stack) for ours in OURS]
        for number in range(1 + chosen.rounds):
            frames = chosen.frames // chosen.rounds if number else WARM_UP
            for server in servers:
                turn = server.drive(folder / "pictures", frames, chosen.turn_seconds)
                print(f"round {number}: {server.name}: {turn.replies_per_s:,.1f} replies/s", file=sys.stderr)
        print(f"{chosen.rounds} rounds, {os.cpu_count()} cores\n")
        print_round_trips(servers)
        print_stages(servers)


def start_contender(ours: str, run: Path, folder: Path, stack: ExitStack) -> Server:
    flags = (*VIEWER, str(folder / "drive.rrd")) if OURS[ours] == VIEWER else OURS[ours]
    server = start_ours(ours, run, folder / f"{list(OURS).index(ours)}.mcap", stack, *flags)
    server.suspend()
    return server


def print_round_trips(servers: list[Server]) -> None:
    """What the client saw."""
    print("| | replies/s | p50 | p99 | telemetries |\n|---|---|---|---|---|")
    for server in servers:
        rates = [turn.replies_per_s for turn in server.turns[1:]]
        trips = [trip for turn in server.turns[1:] for trip in turn.round_trips_ms]
        p50, p99 = np.percentile(trips, (50, 99))
        spread = f"{statistics.median(rates):,.1f} ({min(rates):,.1f} to {max(rates):,.1f})"
        print(f"| {server.name} | {spread} | {p50:.2f} ms | {p99:.2f} ms | {len(trips):,} |")


def print_stages(servers: list[Server]) -> None:
    """What our servers wrote down, after they have ended."""
    print("\n| inside the server, p50 / p99 / most | parse | decode and crop | network | all |")
    print("|---|---|---|---|---|")
    for server in servers:
        code = server.end()
        if code != 0:
            print(f"{server.name}: exit code {code}\n{server.said()}", file=sys.stderr)
        assert server.log is not None  # noqa: S101
        with Log(server.log) as log:
            commands = [command for _, command in log.commands()]
            computed = f"{log.metadata['arithmetic']} on {log.metadata['device']}"
        told = sum(len(turn.round_trips_ms) for turn in server.turns)
        if len(commands) != told:
            print(f"{server.name}: {told:,} telemetries, {len(commands):,} logged", file=sys.stderr)
        cells = []
        for stage in STAGES:
            spent_ms = [getattr(command, stage) for command in commands[len(server.turns[0].round_trips_ms) :]]
            p50, p99 = np.percentile(spent_ms, (50, 99))
            cells.append(f"{p50:.2f} / {p99:.2f} / {max(spent_ms):.2f} ms")
        print(f"| {server.name}, {computed} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
