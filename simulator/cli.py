"""`bc-sim`: the simulator as a process of its own, which connects to `bc-drive` as the real one does."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from common import UserError
from common.command import DONE, FAILED, run_command
from common.progress import track
from simulator.client import SimulatorClient, WaitTimeoutError
from simulator.replay import replay


@dataclass(frozen=True)
class Sim:
    """Connect to bc-drive as the Udacity simulator does, and tell it recorded pictures as telemetry."""

    folder: Annotated[Path, tyro.conf.arg(name="replay", metavar="FOLDER")]
    """A recording of the Udacity simulator: the pictures of its centre camera are told in their order."""
    count: int | None = None
    """How many pictures to tell; all of them by default."""
    host: str = "127.0.0.1"
    """Where bc-drive listens."""
    port: int = 4567
    """Where bc-drive listens."""
    wait: float = 60.0
    """Seconds to wait for bc-drive before giving up."""


def sim(config: Sim) -> int:
    images = config.folder / "IMG" if (config.folder / "IMG").is_dir() else config.folder
    pictures = sorted(images.glob("center_*.jpg"))[: config.count]
    if not pictures:
        raise UserError(f"{images}: no center_*.jpg in it; give a folder that the simulator recorded into")
    client = SimulatorClient(config.host, config.port, wait_s=config.wait)
    start_s = 0.0

    def jpegs() -> Iterator[bytes]:
        nonlocal start_s
        start_s = time.perf_counter()  # now that somebody listens
        for path in track(pictures, "driving", len(pictures)):
            yield path.read_bytes()

    try:
        commands = replay(client, jpegs())
    except WaitTimeoutError as error:
        raise UserError(f"{error}; start `bc-drive` first, or wait longer with --wait") from None
    seconds = time.perf_counter() - start_s
    steps = [abs(b.steering - a.steering) for a, b in itertools.pairwise(commands)]
    roughness = sum(steps) / len(steps) if steps else 0.0
    print(
        f"{client.telemetries:,} telemetries, {client.steers:,} answers, {client.bad_steers:,} unreadable;"
        f" {client.steers / seconds:,.0f} answers/s; mean change of steering {roughness:.3f}"
    )
    return DONE if client.steers == client.telemetries else FAILED


def main() -> None:
    run_command("bc-sim", Sim, sim)
