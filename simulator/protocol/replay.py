"""Recorded pictures sent to a server as telemetry, as if the simulator drove past them once more."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from common import UserError
from simulator.protocol.client import (
    ServerCommand,
    SimulatorClient,
    SimulatorMessage,
    SimulatorTelemetry,
    SteerCommand,
)


def pictures_of(recording: Path) -> list[Path]:
    """The centre camera's pictures of a recording, in their order.

    Raises UserError, which names what `recording` is instead, if it has none.
    """
    if not recording.exists():
        raise UserError(f"--replay {recording}: no such folder; give the one that the simulator recorded into")
    if not recording.is_dir():
        raise UserError(f"--replay {recording}: a file; give the folder that holds driving_log.csv and IMG/")
    images = recording / "IMG" if (recording / "IMG").is_dir() else recording
    pictures = sorted(images.glob("center_*.jpg"))
    if not pictures:
        csv = recording / "driving_log.csv"
        what = "driving_log.csv is empty and there is" if csv.is_file() and not csv.stat().st_size else "there is"
        raise UserError(
            f"--replay {recording}: {what} no center_*.jpg in {images}; give a folder that has"
            " pictures: the simulator renders them once a recording is stopped"
        )
    return pictures


def replay(client: SimulatorClient, jpegs: Iterable[bytes], speed_mph: float = 9.0) -> list[SteerCommand]:
    """Send every picture once, with the steering and throttle that the server last commanded.

    Returns the commands in the order in which they came: one for each picture, if the server answered each.
    """
    pictures = iter(jpegs)
    commands: list[SteerCommand] = []
    waiting = 0  # telemetries in flight
    lost = 0  # unreadable answers, which this client never hears of
    connection = 0

    def next_telemetry(received: ServerCommand) -> SimulatorMessage:
        nonlocal waiting, lost, connection
        if client.connections != connection:  # whatever was in flight on the last one is lost
            waiting, connection = 0, client.connections
        waiting, lost = waiting - (client.bad_steers - lost), client.bad_steers
        if isinstance(received, SteerCommand):
            commands.append(received)
        if received is not None:  # also `manual`, from a server that only listens
            waiting -= 1
        jpeg = next(pictures, None)
        if jpeg is None:
            # the last picture was sent; go on reading until everything in flight is answered
            return None if waiting <= 0 else "nothing"
        waiting += 1
        last = commands[-1] if commands else SteerCommand(0.0, 0.0)
        throttle = min(max(last.throttle, 0.0), 1.0)
        return SimulatorTelemetry(min(max(last.steering, -1.0), 1.0), throttle, speed_mph, jpeg)

    client.run(next_telemetry)
    return commands
