"""A simulator that measures how old its pictures are when they are answered; to be run as a process.

Its pictures are grey, each as bright as its number says, so that an answer that gives the brightness names the
picture. Arguments: the port, the telemetries in flight (1 or 2), a file that ends it. The ages in ms go to stdout.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from simulator.protocol.client import (
    ServerCommand,
    SimulatorClient,
    SimulatorMessage,
    SimulatorTelemetry,
    SteerCommand,
)

PICTURES = 50
LEVELS = 5  # of brightness from one picture to the next

ANSWERS_BRIGHTNESS = (
    "import time, model.pilot as it",
    "it.Pilot.answer = lambda self, crop: time.sleep(0.03) or it.NetworkAnswer(float(crop.mean()) / 255)",
)
"""Python for `driving.command_after`: a network that takes 30 ms, and answers a picture's brightness."""


def main(port: int, in_flight: Literal[1, 2], end: Path) -> None:
    pictures = [grey(number * LEVELS) for number in range(PICTURES)]
    sent_s: dict[int, float] = {}
    ages_ms: list[float] = []
    sent, answered = 0, -1

    def next_telemetry(command: ServerCommand) -> SimulatorMessage:
        nonlocal sent, answered
        if isinstance(command, SteerCommand):
            number = round(command.steering * 255 / LEVELS)
            if number != answered and number in sent_s:  # else it answers none
                ages_ms.append((time.perf_counter() - sent_s[number]) * 1e3)
                answered = number
        if end.exists():
            return None
        sent += 1
        sent_s[sent % PICTURES] = time.perf_counter()
        return SimulatorTelemetry(0.0, 0.0, 9.0, pictures[sent % PICTURES])

    SimulatorClient(port=port, in_flight=in_flight).run(next_telemetry)
    print(json.dumps(ages_ms))


def grey(level: int) -> bytes:
    ok, encoded = cv2.imencode(".jpg", np.full((160, 320, 3), level, np.uint8))
    assert ok
    return encoded.tobytes()


if __name__ == "__main__":
    main(int(sys.argv[1]), 1 if sys.argv[2] == "1" else 2, Path(sys.argv[3]))
