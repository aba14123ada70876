"""Shared by the benchmarks of driving: servers in separate processes, their turns, and the pictures.

A server that waits for its turn is suspended with its child processes, so that only one server computes at a time.
"""

from __future__ import annotations

import contextlib
import json
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Final

import numpy as np
import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk

from recorder import Log
from recorder.topics import camera_topic
from simulator.driving.simulation import Simulation
from simulator.pose import Pose

HERE: Final = Path(__file__).parent
PATIENCE_S: Final = 120.0  # until a server listens, or has ended
RENDERED: Final = 300  # pictures, without a recording


@dataclass(frozen=True)
class Turn:
    """The client's measurements of one server in one turn."""

    seconds: float
    round_trips_ms: list[float]

    @property
    def replies_per_s(self) -> float:
        return len(self.round_trips_ms) / self.seconds


@dataclass
class Server:
    """A running server."""

    name: str
    process: psutil.Popen
    port: int
    errors: IO[str]
    log: Path | None = None
    turns: list[Turn] = field(default_factory=list)

    def drive(self, pictures: Path, frames: int, seconds: float) -> Turn:
        """One turn: `frames` messages, or as many as `seconds` allow."""
        self.resume()
        line = [sys.executable, str(HERE / "driving_client.py"), str(self.port), str(pictures), str(frames)]
        line += ["--seconds", str(seconds)]
        client = subprocess.run(line, stdout=subprocess.PIPE, text=True, check=False)
        if client.returncode != 0:
            raise SystemExit(f"{self.name}: the client failed\n{self.last_errors()}")
        turn = Turn(**json.loads(client.stdout))
        self.turns.append(turn)
        self.suspend()
        return turn

    def children(self) -> list[psutil.Process]:
        """The child processes of the server."""
        children: list[psutil.Process] = self.process.children(recursive=True)
        return children

    def suspend(self) -> None:
        self.process.suspend()
        for child in self.children():
            child.suspend()

    def resume(self) -> None:
        self.process.resume()
        for child in self.children():
            child.resume()

    def end(self) -> int:
        """End the server as Ctrl-C does. Returns its exit code."""
        self.resume()
        self.process.send_signal(signal.SIGINT)
        return int(self.process.wait(PATIENCE_S))

    def last_errors(self) -> str:
        """The end of the server's stderr."""
        self.errors.seek(0)
        return self.errors.read()[-2000:]


def start(name: str, line: list[str], port: int, stack: ExitStack) -> Server:
    """Start a server with the command `line`, and wait until it listens on `port`. It ends with `stack`."""
    errors = stack.enter_context(tempfile.TemporaryFile("w+"))  # noqa: SIM115
    process = psutil.Popen(line, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors)
    server = Server(name, process, port, errors)
    stack.callback(_kill, server)
    deadline_s = time.monotonic() + PATIENCE_S
    while not _listens(server):
        if process.poll() is not None or time.monotonic() > deadline_s:
            raise SystemExit(f"{name}: does not listen; its output:\n{server.last_errors()}")
        time.sleep(0.1)
    return server


def start_ours(name: str, run: Path, log: Path, stack: ExitStack, *flags: str) -> Server:
    """Start `bc-drive` with `run`, which writes `log`."""
    port = free_port()
    code = "from drive.cli import main; main()"
    hidden = () if "--viewer" in flags else ("--viewer", "off")
    line = [sys.executable, "-c", code, str(run), "--log", str(log), "--port", str(port), *hidden, *flags]
    server = start(name, line, port, stack)
    server.log = log
    return server


def free_port() -> int:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        port: int = bound.getsockname()[1]
        return port


def write_pictures(recording: Path | None, folder: Path) -> int:
    """Write the centre camera's JPEGs to `folder`, in order. Returns their number. They come from a folder of
    Udacity's simulator, from a log, or from a lap of the built-in simulator's lake track."""
    count = 0
    for count, jpeg in enumerate(_pictures(recording), 1):
        (folder / f"{count:06}.jpg").write_bytes(jpeg)
    if not count:
        raise SystemExit(f"{recording}: no picture of a centre camera")
    return count


def _pictures(recording: Path | None) -> Iterator[bytes]:
    if recording is None:
        simulation = Simulation("lake")
        line = simulation.track.line
        for arc_m in np.linspace(0.0, line.length_m, RENDERED, endpoint=False):
            place = line.at(arc_m)
            pose = Pose(place.x_m, place.y_m, place.z_m, place.heading_rad, float(np.arctan(place.slope)))
            yield simulation.jpeg(pose=pose)
    elif recording.is_dir():
        for path in sorted(recording.glob("IMG/center*.jpg")):
            yield path.read_bytes()
    else:
        with Log(recording) as log:
            pictures = log.pictures(camera_topic("center"))
            for at in range(len(pictures.offset)):
                yield log.read(int(pictures.offset[at]), int(pictures.length[at]), int(pictures.chunk[at]))


def _listens(server: Server) -> bool:
    with contextlib.suppress(psutil.Error):  # the server has ended
        connections = server.process.net_connections("tcp")
        return any(c.status == psutil.CONN_LISTEN and c.laddr.port == server.port for c in connections)
    return False


def _kill(server: Server) -> None:
    with contextlib.suppress(psutil.NoSuchProcess):
        for process in [*server.children(), server.process]:
            process.kill()
    server.process.wait()
