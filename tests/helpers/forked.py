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

from tests.helpers.repository import HELPERS

# No program reads these while it starts. The first two lines matter when something is shown, the third when a
# command asks for its cache or an object store. The other variables, and those of Ray, are set for this process by
# what a test has called: a training, MLflow, PyTorch's exporter, a server, the viewer, gymnasium, polars.
_UNREAD: Final = (
    *("PYTEST_CURRENT_TEST", "DISPLAY"),
    *("NO_COLOR", "TERM"),
    *("BC_CACHE", "AWS_ENDPOINT_URL_S3", "AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_REGION"),
    *("THP_MEM_ALLOC_ENABLE", "TORCHINDUCTOR_CACHE_DIR", "MLFLOW_EXPERIMENT_ID"),
    *("EVENTLET_NO_GREENDNS", "RUST_LOG"),
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
        """As `python -c code *arguments`, with pipes for its output."""
        read_out, out = os.pipe()
        read_error, error = os.pipe()
        try:
            return self.start_to(out, error, code, arguments, cwd, environment, (read_out, read_error))
        finally:
            os.close(out)
            os.close(error)

    def start_to(
        self,
        out: int,
        error: int,
        code: str,
        arguments: Sequence[str],
        cwd: Path | None,
        environment: Mapping[str, str],
        read: tuple[int, int] | None = None,
    ) -> Forked:
        """The same, with these open files for its output; `read`: the other ends of them, where it is read here.
        The server begins with the first one, and ends with this process."""
        asked = {
            "code": code,
            "arguments": arguments,
            "cwd": str(cwd or Path.cwd()),
            "environment": dict(environment),
        }
        with self._begins:
            if self._connection is None:
                self._connection = self._begin()
        status, told = socket.socketpair()
        with told, Path(os.devnull).open("rb") as nothing:
            files = [nothing.fileno(), out, error, told.fileno()]
            socket.send_fds(self._connection, [json.dumps(asked).encode()], files)
        return Forked(status, read)

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
    """A program that was forked: as subprocess.Popen, as far as tests need it."""

    def __init__(self, status: socket.socket, read: tuple[int, int] | None) -> None:
        """`read`: where its stdout and stderr are read, if they are pipes to here."""
        self.stdout: IO[str] | None = None
        self.stderr: IO[str] | None = None
        if read is not None:
            self.stdout, self.stderr = (os.fdopen(end, encoding="utf-8") for end in read)
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

    kept = {
        name: value for name, value in environment.items() if name not in _UNREAD and not name.startswith("RAY_")
    }
    return kept, [resource.getrlimit(getattr(resource, name)) for name in _LIMITS]
