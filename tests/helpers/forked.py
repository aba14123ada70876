"""Commands that are forked from a process that has PyTorch loaded (fork_server.py) instead of started.

A start costs one or two seconds of processor time, nearly all of it for imports. What a fork does not show: the
order of sets and imports is the same in all forks of one process, and objects are not deleted at its end."""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Final

from repository import HELPERS

# all but the first two are set for this process by what a test has called: a server, the viewer, gymnasium, polars
_UNREAD: Final = (
    *("PYTEST_CURRENT_TEST", "DISPLAY", "EVENTLET_NO_GREENDNS", "RUST_LOG"),
    *("PYGAME_HIDE_SUPPORT_PROMPT", "_RJEM_MALLOC_CONF"),
)
_LIMITS: Final = ("RLIMIT_AS", "RLIMIT_DATA", "RLIMIT_FSIZE", "RLIMIT_NOFILE")


class ForkServer:
    """Forks Python programs that have this environment, working folders aside."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._inherited = _inherited(environment)
        self._connection: socket.socket | None = None
        self._begins = threading.Lock()

    def can_start(self, environment: Mapping[str, str]) -> bool:
        """Whether a fork has all that a process inherits: else it must be started."""
        is_measured = "COVERAGE_PROCESS_START" in environment
        return sys.platform == "linux" and not is_measured and _inherited(environment) == self._inherited

    def start(
        self, code: str, arguments: Sequence[str], cwd: Path | None, environment: Mapping[str, str]
    ) -> Forked:
        """As `python -c code *arguments`. The server begins with the first one, and ends with this process."""
        asked = {
            "code": code,
            "arguments": arguments,
            "cwd": str(cwd or Path.cwd()),
            "environment": dict(environment),
        }
        with self._begins:
            if self._connection is None:
                self._connection = self._begin()
        read_out, out = os.pipe()
        read_error, error = os.pipe()
        status, told = socket.socketpair()
        files = [os.open(os.devnull, os.O_RDONLY), out, error, told.detach()]
        socket.send_fds(self._connection, [json.dumps(asked).encode()], files)
        for file in files:
            os.close(file)
        return Forked(read_out, read_error, status)

    def _begin(self) -> socket.socket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        code = (HELPERS / "fork_server.py").read_text(encoding="utf-8")
        with theirs:
            line, environment = [sys.executable, "-c", code], self._inherited[0]
            server = subprocess.Popen(
                line, cwd="/", env=environment, stdin=theirs.fileno(), stdout=subprocess.DEVNULL
            )

        def end() -> None:
            ours.close()
            server.wait()

        atexit.register(end)
        return ours


class Forked:
    """A program that was forked: as subprocess.Popen with pipes for stdout and stderr, as far as tests need it."""

    def __init__(self, stdout: int, stderr: int, status: socket.socket) -> None:
        self.stdout: IO[str] = os.fdopen(stdout, encoding="utf-8")
        self.stderr: IO[str] = os.fdopen(stderr, encoding="utf-8")
        self._told = status.makefile("r")
        status.close()
        self.pid = int(self._told.readline())
        self.returncode: int | None = None

    def wait(self, timeout: float | None = None) -> int:
        """The exit code, as Popen has it. Raises subprocess.TimeoutExpired."""
        if self.returncode is None:
            if not select.select([self._told], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0)
            with self._told:
                self.returncode = os.waitstatus_to_exitcode(int(self._told.readline()))
        return self.returncode

    def poll(self) -> int | None:
        """The exit code, or None while it runs."""
        try:
            return self.wait(0)
        except subprocess.TimeoutExpired:
            return None

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


def _inherited(environment: Mapping[str, str]) -> tuple[dict[str, str], list[Any]]:
    """What a program gets from whoever starts it, but for what nothing reads that the server loads."""
    if sys.platform == "win32":
        return {}, []
    import resource

    kept = {name: value for name, value in environment.items() if name not in _UNREAD}
    return kept, [resource.getrlimit(getattr(resource, name)) for name in _LIMITS]
