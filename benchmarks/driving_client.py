"""The simulator's side of driving_replies.py: Udacity's wire behaviour, with exactly one message in flight.

python benchmarks/driving_client.py PORT PICTURES FRAMES [--seconds 30]

Sends FRAMES pictures, the JPEG files in the folder PICTURES again and again, each as soon as the one before is
answered. Prints the fields of `Turn` in driving_servers.py as one line of JSON.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path
from typing import Final

from simulator.protocol.client import (
    ServerCommand,
    SimulatorClient,
    SimulatorMessage,
    SimulatorTelemetry,
    SteerCommand,
    WaitTimeoutError,
)

PATIENCE_S: Final = 10.0  # short, because the server already listens


class OneInFlight:
    """Sends pictures to a server, and stores the time of each round trip."""

    def __init__(self, pictures: list[bytes], frames: int, seconds: float) -> None:
        self.round_trips_ms: list[float] = []
        self._pictures = itertools.cycle(pictures)
        self._frames = frames
        self._limit_s = seconds
        self._opened = 0
        self._start_s = self._sent_s = self._end_s = 0.0
        self._last = SteerCommand(0.0, 0.0)

    @property
    def seconds(self) -> float:
        """Seconds from the first message to the last answer."""
        return self._end_s - self._start_s

    def next_telemetry(self, answer: ServerCommand) -> SimulatorMessage:
        self._end_s = time.perf_counter()
        if answer is None:
            # Udacity's client takes both the socket and the server's greeting for an "open".
            self._opened += 1
            if self._opened != 2:
                return "nothing"
            self._start_s = self._end_s
        elif isinstance(answer, SteerCommand):
            self.round_trips_ms.append((self._end_s - self._sent_s) * 1e3)
            self._last = answer
        if len(self.round_trips_ms) == self._frames or self._end_s - self._start_s > self._limit_s:
            return None
        self._sent_s = time.perf_counter()
        throttle = min(max(self._last.throttle, 0.0), 1.0)
        return SimulatorTelemetry(min(max(self._last.steering, -1.0), 1.0), throttle, 9.0, next(self._pictures))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("port", type=int)
    parser.add_argument("pictures", type=Path)
    parser.add_argument("frames", type=int)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="end the turn after this time")
    chosen = parser.parse_args()
    pictures = [path.read_bytes() for path in sorted(chosen.pictures.glob("*.jpg"))]
    turn = OneInFlight(pictures, chosen.frames, chosen.seconds)
    client = SimulatorClient(port=chosen.port, wait_s=PATIENCE_S)
    try:
        client.run(turn.next_telemetry)
    except WaitTimeoutError as error:
        raise SystemExit(str(error)) from None
    if client.connections != 1 or client.steers != client.telemetries:
        raise SystemExit(
            f"{client.telemetries} telemetries in {client.connections} connections, {client.steers} commands"
        )
    print(json.dumps({"seconds": turn.seconds, "round_trips_ms": turn.round_trips_ms}))


if __name__ == "__main__":
    main()
