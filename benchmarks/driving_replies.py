"""Replies per second and round trips of driving.

python benchmarks/driving_replies.py RUN --recording lake_windows

The client is `simulator/protocol/client.py`, which has Udacity's wire behaviour, with one message in flight. The
client and each server are separate processes. A turn is one connection. The servers take turns; a waiting server
is suspended with its child processes. The first round warms up and is not counted. All servers drive with the
network of RUN. Without --recording, the pictures are from the built-in simulator. The second table shows the times
in the logs of `bc-drive`.
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

WARM_UP, TURN = 50, 2_000  # messages
ROUNDS: Final = 5  # turns of each server that count
STAGES: Final = ("parse_ms", "decode_ms", "network_ms", "total_ms")

VIEWER: Final = ("--viewer",)  # a viewer that writes a file
OURS: Final = {
    "`bc-drive`": (),
    "`bc-drive --viewer`": VIEWER,
    "`bc-drive --precision float32`": ("--precision", "float32"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="the folder of a run")
    parser.add_argument("--recording", type=Path, help="a folder of the Udacity simulator, or a log")
    parser.add_argument("--turn-seconds", type=float, default=30.0, help="time limit of a turn")
    chosen = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # else suspended servers would outlive this process
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        (folder / "pictures").mkdir()
        write_pictures(chosen.recording, folder / "pictures")
        servers = [start_contender(ours, chosen.run, folder, stack) for ours in OURS]
        for number in range(1 + ROUNDS):
            frames = TURN if number else WARM_UP
            for server in servers:
                turn = server.drive(folder / "pictures", frames, chosen.turn_seconds)
                print(f"round {number}: {server.name}: {turn.replies_per_s:,.1f} replies/s", file=sys.stderr)
        print(f"{ROUNDS} rounds, {os.cpu_count()} cores\n")
        print_round_trips(servers)
        print_stages(servers)


def start_contender(ours: str, run: Path, folder: Path, stack: ExitStack) -> Server:
    flags = (*VIEWER, str(folder / "drive.rrd")) if OURS[ours] == VIEWER else OURS[ours]
    server = start_ours(ours, run, folder / f"{list(OURS).index(ours)}.mcap", stack, *flags)
    server.suspend()
    return server


def print_round_trips(servers: list[Server]) -> None:
    """Print the measurements of the client."""
    print("| | replies/s | p50 | p99 | telemetries |\n|---|---|---|---|---|")
    for server in servers:
        rates = [turn.replies_per_s for turn in server.turns[1:]]
        trips = [trip for turn in server.turns[1:] for trip in turn.round_trips_ms]
        p50, p99 = np.percentile(trips, (50, 99))
        spread = f"{statistics.median(rates):,.1f} ({min(rates):,.1f} to {max(rates):,.1f})"
        print(f"| {server.name} | {spread} | {p50:.2f} ms | {p99:.2f} ms | {len(trips):,} |")


def print_stages(servers: list[Server]) -> None:
    """End the servers, and print the times in their logs."""
    print("\n| inside the server, p50 / p99 / most | parse | decode and crop | network | all |")
    print("|---|---|---|---|---|")
    for server in servers:
        code = server.end()
        if code != 0:
            print(f"{server.name}: exit code {code}\n{server.last_errors()}", file=sys.stderr)
        assert server.log is not None  # noqa: S101
        with Log(server.log) as log:
            commands = [command for _, command in log.commands()]
            computed = f"{log.metadata['arithmetic']} on {log.metadata['device']}"
        sent = sum(len(turn.round_trips_ms) for turn in server.turns)
        if len(commands) != sent:
            print(f"{server.name}: {sent:,} telemetries, {len(commands):,} logged", file=sys.stderr)
        cells = []
        for stage in STAGES:
            spent_ms = [getattr(command, stage) for command in commands[len(server.turns[0].round_trips_ms) :]]
            p50, p99 = np.percentile(spent_ms, (50, 99))
            cells.append(f"{p50:.2f} / {p99:.2f} / {max(spent_ms):.2f} ms")
        print(f"| {server.name}, {computed} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
