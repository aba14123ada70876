"""Send recorded pictures to a server as telemetry, like a simulator that drives the recording again."""

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
    """The centre camera's pictures of a recording, in order. Raises UserError, with the reason, if it has none."""
    if not recording.exists():
        raise UserError(f"--replay {recording}: no such folder; give the folder of a recording of the simulator")
    if not recording.is_dir():
        raise UserError(f"--replay {recording}: a file; give the folder that holds driving_log.csv and IMG/")
    images = recording / "IMG" if (recording / "IMG").is_dir() else recording
    pictures = sorted(images.glob("center_*.jpg"))
    if not pictures:
        csv = recording / "driving_log.csv"
        start = "driving_log.csv is empty and there is" if csv.is_file() and not csv.stat().st_size else "there is"
        raise UserError(
            f"--replay {recording}: {start} no center_*.jpg in {images}; give a folder with pictures: the"
            " simulator renders them when a recording is stopped"
        )
    return pictures


def replay(client: SimulatorClient, jpegs: Iterable[bytes], speed_mph: float = 9.0) -> list[SteerCommand]:
    """Send every picture once, with the steering and throttle of the server's last command.

    Returns the commands in the order of arrival: one for each picture, if the server answered all of them.
    """
    pictures = iter(jpegs)
    commands: list[SteerCommand] = []
    waiting = 0  # telemetries in flight
    lost = 0  # unreadable answers, for which `next_telemetry` is not called
    connection = 0

    def next_telemetry(received: ServerCommand) -> SimulatorMessage:
        nonlocal waiting, lost, connection
        if client.connections != connection:  # telemetries in flight on the last connection are lost
            waiting, connection = 0, client.connections
        waiting, lost = waiting - (client.bad_steers - lost), client.bad_steers
        if isinstance(received, SteerCommand):
            commands.append(received)
        if received is not None:  # a command, or `manual` from a server that only listens
            waiting -= 1
        jpeg = next(pictures, None)
        if jpeg is None:
            # the last picture was sent; continue to listen until everything in flight is answered
            return None if waiting <= 0 else "nothing"
        waiting += 1
        last = commands[-1] if commands else SteerCommand(0.0, 0.0)
        throttle = min(max(last.throttle, 0.0), 1.0)
        return SimulatorTelemetry(min(max(last.steering, -1.0), 1.0), throttle, speed_mph, jpeg)

    client.run(next_telemetry)
    return commands
