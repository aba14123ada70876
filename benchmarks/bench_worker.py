"""One version's work for bench.py, which names on stdin what to do next: a line with a figure's name.

The answer is a line with what was done per second of processor time. The only argument is a folder for inputs.
"""

from __future__ import annotations

import itertools
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import torch
from driving_client import OneInFlight
from driving_servers import start_ours, write_pictures
from indexing import write_log

from dataset import IndexConfig, build_index
from driving import untrained_run
from model.adam import Adam
from model.config import TrainConfig
from model.device import choose_machine
from model.network.original import SteeringNetwork
from model.training.step import training_step
from simulator.protocol.client import SimulatorClient

ROWS: Final = 2_000  # of the log that is indexed
INDEXES: Final = 8
REPLIES: Final = 80

Work = Callable[[], float]


def training_step_work(inputs: Path, scratch: Path, stack: ExitStack) -> Work:
    """The default network learns random pictures in memory."""
    config = TrainConfig(device="cpu")
    machine = choose_machine(config)
    network = SteeringNetwork(config.dropout).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    network.train()
    optimizer = Adam(network.parameters(), config.rate)
    count = machine.micro_batch
    pictures = torch.randint(0, 256, (count, 128, 128, 3), dtype=torch.uint8).permute(0, 3, 1, 2)
    steering = torch.rand(count) * 2 - 1

    def samples_per_s() -> float:
        begin_s = time.process_time()
        training_step(network, optimizer, pictures, steering, dtype=machine.dtype, micro_batch=count)
        return count / (time.process_time() - begin_s)

    return samples_per_s


def index_work(inputs: Path, scratch: Path, stack: ExitStack) -> Work:
    """A log of three cameras is indexed anew, with balanced samples."""
    log = write_log(inputs, ROWS, 0)
    numbers = itertools.count()

    def frames_per_s() -> float:
        begin_s = time.process_time()
        made = [build_index([log], scratch / f"index{next(numbers)}", IndexConfig()) for _ in range(INDEXES)]
        taken_s = time.process_time() - begin_s
        return sum(counts.frames for index in made for counts in index.counts.values()) / taken_s

    return frames_per_s


def reply_work(inputs: Path, scratch: Path, stack: ExitStack) -> Work:
    """`bc-drive` with the default network answers a client with one telemetry in flight."""
    folder = inputs / "pictures"
    if not folder.exists():
        folder.mkdir()
        write_pictures(None, folder)
    pictures = [path.read_bytes() for path in sorted(folder.iterdir())]
    run = untrained_run(scratch / "run", network="original")
    server = start_ours("bc-drive", run, scratch / "drive.mcap", stack)
    server.suspend()

    def replies_per_s() -> float:
        server.resume()
        begin = server.process.cpu_times()
        client = SimulatorClient(port=server.port)
        client.run(OneInFlight(pictures, REPLIES, 60.0).next_telemetry)
        end = server.process.cpu_times()
        server.suspend()
        return client.steers / float(end.user + end.system - begin.user - begin.system)

    return replies_per_s


WORKS: Final = {"training step": training_step_work, "index": index_work, "reply": reply_work}


def main() -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # the server ends, too
    inputs = Path(sys.argv[1])
    works: dict[str, Work] = {}
    with tempfile.TemporaryDirectory(dir=inputs) as scratch, ExitStack() as stack:
        for line in sys.stdin:
            name = line.strip()
            if name not in works:
                works[name] = WORKS[name](inputs, Path(scratch), stack)
            print(works[name](), flush=True)


if __name__ == "__main__":
    main()
