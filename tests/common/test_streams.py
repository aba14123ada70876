"""Who reads a command's output may stop reading, or go away: it costs lines, never answers, files or codes."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import pytest

from model.runs.run_folder import find_run
from recorder import Log
from simulator.protocol.client import SimulatorClient
from simulator.protocol.replay import replay
from tests.helpers.driving import (
    PATIENCE_S,
    PATIENT,
    command,
    command_after,
    environment,
    road_jpeg,
    run,
    untrained_run,
)
from tests.helpers.ports import free_ports
from tests.helpers.toy import toy_index
from tests.helpers.udacity import make_recording, paths

if sys.platform == "win32":
    pytest.skip("pipes and terminals as Unix has them", allow_module_level=True)

CLIENTS, PICTURES = 4, 10


class Reader:
    """Who reads stdout and stderr of a command; here, all of it, up to the end."""

    def __init__(self) -> None:
        self._read, self.write = os.pipe()

    def begin(self) -> None:
        """When the command has the other end."""
        os.close(self.write)

    def end(self) -> None:
        os.close(self._read)


class Head(Reader):
    """`| head -1`."""

    def begin(self) -> None:
        super().begin()
        line = b""
        while not line.endswith(b"\n"):
            line += os.read(self._read, 1)
        os.close(self._read)

    def end(self) -> None:
        """It has gone already."""


class Stuck(Reader):
    """One who has stopped reading, as by SIGSTOP: the pipe is full."""

    def __init__(self) -> None:
        super().__init__()
        fill(self.write)


class StoppedTerminal(Stuck):
    """A terminal that takes nothing any more, as after Ctrl-S."""

    def __init__(self) -> None:
        self._read, self.write = os.openpty()
        fill(self.write)


class ClosedTerminal(Reader):
    """A terminal whose window was closed, of a command that was started by `setsid`."""

    def __init__(self) -> None:
        self._read, self.write = os.openpty()

    def begin(self) -> None:
        super().begin()
        os.read(self._read, 1)
        os.close(self._read)

    def end(self) -> None:
        """It has gone already."""


def fill(descriptor: int) -> None:
    os.set_blocking(descriptor, False)
    try:
        while True:
            os.write(descriptor, b"." * 1000)
    except BlockingIOError:
        pass
    try:
        while True:
            os.write(descriptor, b".")
    except BlockingIOError:
        os.set_blocking(descriptor, True)


READERS = [Head, Stuck, StoppedTerminal, ClosedTerminal]


@contextmanager
def read_by(
    kind: Callable[[], Reader], line: list[str], cwd: Path | None = None, results: BinaryIO | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """A command that has begun, with what it says going to such a reader; its results, to a file that is given."""
    reader = kind()
    out = results.fileno() if results else reader.write
    process = subprocess.Popen(line, cwd=cwd, env=environment(), stdout=out, stderr=reader.write)
    try:
        reader.begin()
        yield process
    finally:
        process.kill()
        process.wait(PATIENCE_S)
        reader.end()


def answers_to(port: int) -> list[int]:
    """How many answers each of some clients gets, one after the other: each comes and goes, which is said."""
    got = []

    def drive() -> None:
        for _ in range(CLIENTS):
            client = SimulatorClient(port=port, wait_s=PATIENCE_S)
            replay(client, [road_jpeg(number) for number in range(PICTURES)])
            got.append(client.steers + client.manuals)

    driving = threading.Thread(target=drive, daemon=True)
    driving.start()
    driving.join(PATIENCE_S)
    return got


@pytest.fixture(scope="module")
def pilot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return untrained_run(tmp_path_factory.mktemp("runs") / "pilot")


# terminals in `make test`: test_listening_answers_whoever_reads_what_it_says
TERMINALS = [pytest.param(kind, marks=pytest.mark.long) for kind in (StoppedTerminal, ClosedTerminal)]


@pytest.mark.parametrize("reader", [Head, Stuck, *TERMINALS])
def test_a_drive_answers_whoever_reads_what_it_reports(reader: type[Reader], pilot: Path, tmp_path: Path) -> None:
    log, [port] = tmp_path / "run.mcap", free_ports(1)
    with read_by(reader, command_after(PATIENT, "bc-drive", pilot, "--log", log, "--port", port)) as process:
        assert answers_to(port) == [PICTURES] * CLIENTS
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
    with Log(log) as driven:
        assert len(driven.vehicle()) == PICTURES * CLIENTS


@pytest.mark.parametrize("reader", READERS)
def test_listening_answers_whoever_reads_what_it_reports(reader: type[Reader], tmp_path: Path) -> None:
    [port] = free_ports(1)
    line = command_after(PATIENT, "bc-record", "listen", "live", "--port", port)
    with read_by(reader, line, cwd=tmp_path) as process:
        assert answers_to(port) == [PICTURES] * CLIENTS
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
    with Log(tmp_path / "sessions" / "live.mcap") as log:
        assert len(log.vehicle()) == PICTURES * CLIENTS


@pytest.mark.parametrize("reader", [Head, pytest.param(ClosedTerminal, marks=pytest.mark.long)])
def test_a_recording_is_followed_to_its_end(reader: type[Reader], tmp_path: Path) -> None:
    line = command("bc-import", tmp_path / "drive", "live", "--watch", "--idle", 0.1)
    with read_by(reader, line, cwd=tmp_path) as process:
        make_recording(tmp_path / "made", "".join(f"{paths(number)},0.1,0.5,0,9\n" for number in range(3)))
        (tmp_path / "made").rename(tmp_path / "drive")  # all at once: it does not wait long for the rest
        assert process.wait(PATIENCE_S) == 0
    with Log(tmp_path / "sessions" / "live.mcap") as followed:
        assert len(followed.vehicle()) == 3


def test_a_training_goes_on_when_its_terminal_has_gone(tmp_path: Path) -> None:
    """On which it drew a bar; its results get into a file all the same."""
    log = tmp_path / "said"
    with log.open("wb") as file, read_by(ClosedTerminal, toy_training(tmp_path), tmp_path, file) as process:
        assert process.wait(PATIENCE_S) == 0
    assert "epoch  1" in log.read_text()
    assert len((find_run("toy", tmp_path / "runs") / "metrics.jsonl").read_text().splitlines()) == 1


def test_a_list_that_is_not_read_to_its_end_is_no_error(tmp_path: Path) -> None:
    toy_index(tmp_path)
    with read_by(Head, command("bc-log", "ls", tmp_path), tmp_path) as process:
        assert process.wait(PATIENCE_S) == 0


@pytest.mark.long  # of a terminal: above
def test_a_training_goes_on_when_its_reader_has_gone(tmp_path: Path) -> None:
    with read_by(Head, toy_training(tmp_path), tmp_path) as process:
        assert process.wait(PATIENCE_S) == 0
    assert len((find_run("toy", tmp_path / "runs") / "metrics.jsonl").read_text().splitlines()) == 1


def toy_training(folder: Path) -> list[str]:
    flags = ("--index", toy_index(folder), "--network", "small", "--epochs", 1, "--batch", 8, "--threads", 1)
    return command("bc-train", "--name", "toy", *flags)


LONG = [pytest.param(closed, marks=pytest.mark.long) for closed in ("2>&-", ">&-", ">&- 2>&-")]


@pytest.mark.parametrize("closed", ["<&- >&- 2>&-", *LONG])
def test_streams_that_are_closed_from_the_start_get_into_no_file(closed: str, tmp_path: Path) -> None:
    """Else a file that is opened gets their number, and what any library prints."""
    make_recording(tmp_path / "drive", "".join(f"{paths(number)},0.1,0.5,0,9\n" for number in range(3)))
    line = shlex.join(command("bc-import", tmp_path / "drive", "mine"))
    done = subprocess.run(["sh", "-c", f"{line} {closed}"], cwd=tmp_path, env=environment(), check=False)
    assert done.returncode == 0
    assert run("bc-log", "check", tmp_path / "sessions" / "mine.mcap").returncode == 0


def test_a_full_disk_under_stdout_is_reported() -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            command("bc-log", "--help"), env=environment(), stdout=full, stderr=subprocess.PIPE, check=False
        )
    assert done.returncode == 1
    assert done.stderr.decode() == "bc-log: standard output: No space left on device\n"
