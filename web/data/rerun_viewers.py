"""Logs that are open in Rerun: for each, a process that serves it on this machine, ended when no page shows it.

Rerun's viewer is a program of WebAssembly that the `rerun` program has in it and serves on one port; the log comes
from another one. The viewer's own files are passed on by bc-web, so that its page is one of ours.
"""

from __future__ import annotations

import contextlib
import http.client
import os
import secrets
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from importlib.util import find_spec
from typing import Final

from common.command import FAILED
from common.errors import printable
from common.interrupts import leave_signals_to_main_thread
from common.location import Location, Url
from common.versions import package_line, version_of
from web.data.own_process import own_process
from web.data.project_folders import as_word
from web.errors import WebError

MOST: Final = 2
"""Logs that are open at once; one more ends the oldest."""
FILES: Final = {"re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm"}
"""The viewer's files, and their media types."""

_LOCAL: Final = "127.0.0.1"
_PATIENCE_S: Final = 10.0  # for a file of the viewer
_GRACE_S: Final = 3.0  # for a process to end by itself
_MAX_NOTES: Final = 20
_PREFIX: Final = "bc-play: "
_HINT: Final = "; Ctrl-C ends"  # where to open it, which is done here


class RerunViewer:
    """The process that serves one log to a viewer."""

    def __init__(self, log: Location, *, is_growing: bool) -> None:
        """Raises WebError if it cannot be started."""
        self.key = secrets.token_hex(8)
        try:
            self.web_port, self.data_port = _free_ports(2)
            # of its own: a process that is killed leaves its copy of a log in a store behind
            self._temporary = tempfile.mkdtemp(prefix="bc-web-")
        except OSError as error:
            raise WebError(f"Rerun cannot be started: {error.strerror}", 500) from None
        self._why_ended = ""
        self._is_ended = False
        self.notes: list[str] = []
        """Messages of bc-play, such as what it had to leave out; an error last."""
        if isinstance(log, Url):
            self.notes.append("a copy of the log comes from its store first")
        words = [as_word(log), "--web", f"--web-port={self.web_port}", f"--port={self.data_port}"]
        line = own_process("web.data.rerun_process", *words, *(["--follow"] if is_growing else []))
        environment = {**os.environ, "COLUMNS": "400", "NO_COLOR": "1", "TMPDIR": self._temporary}
        try:
            # its stdin ends with this process, and then it does; a group of its own, so that nothing of it stays
            self._process = subprocess.Popen(
                line,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                env=environment,
                start_new_session=True,
            )
        except OSError as error:
            shutil.rmtree(self._temporary, ignore_errors=True)
            raise WebError(f"Rerun cannot be started: {error.strerror}", 500) from None
        self._reader = threading.Thread(target=self._read, name="rerun", daemon=True)
        self._reader.start()

    def is_listening(self) -> bool:
        """Whether its viewer can be opened by now."""
        for port in (self.web_port, self.data_port):
            try:
                socket.create_connection((_LOCAL, port), _PATIENCE_S).close()
            except OSError:
                return False
        return True

    @property
    def is_ended(self) -> bool:
        """Whether it has ended, or is about to."""
        return self._is_ended or self._process.poll() is not None

    def why_ended(self) -> str:
        """The message of its page at the end."""
        if not self._why_ended and self._process.poll() == FAILED:
            self._reader.join(_GRACE_S)
            self._why_ended = next(reversed(self.notes), "")
        return self._why_ended or "Rerun has ended; open it again"

    def end(self, why: str = "") -> threading.Thread:
        """Begin to end it; the thread ends when all of it has."""
        self._is_ended = True
        self._why_ended = self._why_ended or why
        ending = threading.Thread(target=self._end, name="rerun ends")
        ending.start()
        return ending

    def _end(self) -> None:
        leave_signals_to_main_thread()
        assert self._process.stdin is not None  # noqa: S101
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_GRACE_S)
        if sys.platform != "win32":
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        self._process.wait()
        shutil.rmtree(self._temporary, ignore_errors=True)

    def _read(self) -> None:
        leave_signals_to_main_thread()
        assert self._process.stderr is not None  # noqa: S101
        with self._process.stderr as lines:
            for line in lines:
                text = printable(line.decode("utf-8", "replace").rstrip())
                if text.startswith(_PREFIX) and not text.endswith(_HINT) and len(self.notes) < _MAX_NOTES:
                    self.notes.append(text.removeprefix(_PREFIX))


class RerunViewers:
    """All of them. Each lives as long as the request that has asked for it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[str, RerunViewer] = {}  # the oldest first
        self._endings: list[threading.Thread] = []

    def open(self, log: Location, *, is_growing: bool) -> RerunViewer:
        """Serve a log. Raises WebError where Rerun is not installed, or cannot be started."""
        if find_spec("rerun") is None or find_spec("rerun_cli") is None:
            raise WebError(f"Rerun is not installed here: `{package_line('rerun-sdk')}` brings it", 501)
        viewer = RerunViewer(log, is_growing=is_growing)
        with self._lock:
            others = list(self._open.values())
            self._open[viewer.key] = viewer
        for other in others[: max(0, len(others) + 1 - MOST)]:
            self.end(other, f"ended, because {MOST} logs were opened in Rerun since; open it again")
        return viewer

    def get(self, key: str) -> RerunViewer:
        """Raises WebError if it is not open (any more)."""
        with self._lock:
            found = self._open.get(key)
        if found is None:
            raise WebError("this log is not open in Rerun any more: open it again from its page", 404)
        return found

    def end(self, viewer: RerunViewer, why: str = "") -> None:
        with self._lock:
            if self._open.pop(viewer.key, None) is not None:
                self._endings = [thread for thread in self._endings if thread.is_alive()]
                self._endings.append(viewer.end(why))

    def file(self, name: str) -> bytes:
        """One of the viewer's own `FILES`, from a process that serves it. Raises WebError if none does."""
        with self._lock:
            ports = [viewer.web_port for viewer in self._open.values()]
        for port in ports:
            connection = http.client.HTTPConnection(_LOCAL, port, timeout=_PATIENCE_S)
            with contextlib.closing(connection), contextlib.suppress(OSError, http.client.HTTPException):
                connection.request("GET", f"/{name}")
                answer = connection.getresponse()
                if answer.status == 200:
                    return answer.read()
        raise WebError(f"{name}: Rerun does not answer; open the log again", 503)

    def close(self) -> None:
        """End all of them, and wait for it."""
        with self._lock:
            viewers = list(self._open.values())
        for viewer in viewers:
            self.end(viewer)
        for ending in self._endings:
            ending.join()


def command_of(log: Location) -> str:
    """The command that opens the same beside the browser."""
    return printable(shlex.join(["bc-play", str(log)]))


def viewer_version() -> str:
    """The version of Rerun, under which a browser keeps the viewer's files."""
    return version_of("rerun-sdk")


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as held:
        servers = [held.enter_context(socket.create_server((_LOCAL, 0))) for _ in range(count)]
        return [server.getsockname()[1] for server in servers]
