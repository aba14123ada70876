"""The Rerun viewer as a separate process that listens only on this machine."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

import rerun_cli

from common import UserError
from common.output import print_message
from viz.console import browser_hint

LOCAL: Final = "127.0.0.1"
SENDER_LOG: Final = "error,re_grpc_client=off,re_sdk=off"
"""Rerun's log level in the sending process: closing a viewer while it receives data is not an error."""

_NO_USAGE_DATA: Final = {"CI": "true"}  # Rerun's only switch outside of the user's settings
_PATIENCE_S: Final = 120.0  # for a window to open on a slow and busy machine
_GRACE_S: Final = 1.0  # then a process that ignores SIGTERM, because it is frozen, is killed
_LAST_WORDS_S: Final = 5.0  # time limit to read the stderr of an ended viewer; its children may still hold it
# the viewer's messages if it ends without a graphics adapter, or without a display
_NO_GRAPHICS: Final = re.compile(
    rb"wgpu error|graphics adapter|surface for any enabled backend|get render context", re.IGNORECASE
)
_NO_WINDOW: Final = re.compile(rb"EventLoopError")


@dataclass(frozen=True)
class Ports:
    web: int  # of the page
    data: int

    @property
    def data_address(self) -> str:
        return f"rerun+http://{LOCAL}:{self.data}/proxy"

    @property
    def web_address(self) -> str:
        return f"http://{LOCAL}:{self.web}/?url=rerun%2Bhttp://{LOCAL}:{self.data}/proxy"


def viewer_program() -> Path:
    """The path of the viewer. `rerun` is only a Python wrapper: killing it would not end the viewer."""
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    return Path(rerun_cli.__file__).parent / name


def free_port() -> int:
    with socket.create_server((LOCAL, 0)) as server:
        port: int = server.getsockname()[1]
        return port


class Viewer(subprocess.Popen[bytes]):
    """The process of a viewer. Its output is printed, except messages that explain why it cannot draw: see
    `failure_reason`."""

    def __init__(self, line: list[str], environment: dict[str, str]) -> None:
        super().__init__(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=environment)
        self._failure_reason = ""
        self._reader = threading.Thread(target=self._read, name="viewer", daemon=True)
        self._reader.start()

    def failure_reason(self) -> str:
        """The reason why an ended viewer could not draw, and the remedy; empty if it failed for another reason."""
        self._reader.join(_LAST_WORDS_S)
        return self._failure_reason

    def _read(self) -> None:
        assert self.stderr is not None  # noqa: S101
        is_backtrace = False
        with self.stderr as lines:
            for line in lines:
                if _NO_GRAPHICS.search(line):
                    is_backtrace |= b"panicked" in line  # then follows where
                    self._failure_reason = (
                        "finds no graphics driver; without a graphics card, Debian's and Ubuntu's package"
                        " mesa-vulkan-drivers draws in software (`sudo apt install mesa-vulkan-drivers`)"
                    )
                elif _NO_WINDOW.search(line):
                    self._failure_reason = self._failure_reason or "cannot open a window on this display"
                elif line.strip() and not is_backtrace:
                    print_message(line.decode("utf-8", "replace").rstrip("\r\n"))


@contextlib.contextmanager
def open_viewer(
    ports: Ports, *, web: bool, memory: str | None = None, server_memory: str | None = None
) -> Iterator[Viewer]:
    """Open an empty viewer in a window, or serve it to browsers on this machine.

    The viewer ends with the context. `memory` limits its data ("1GB"), `server_memory` the data for pages that are
    opened later. Raises UserError if a port is taken.
    """
    for port in (ports.web, ports.data) if web else (ports.data,):
        _refuse_taken(port)
    command = [str(viewer_program()), "--bind", LOCAL, "--port", str(ports.data)]
    if web:
        command += ["--serve-web", "--web-viewer-port", str(ports.web)]
    if memory is not None:
        command += ["--memory-limit", memory]
    if server_memory is not None:
        command += ["--server-memory-limit", server_memory]
    wanted = os.environ.get("RUST_LOG", SENDER_LOG)
    environment = {**os.environ, **_NO_USAGE_DATA, "RUST_LOG": "error" if wanted == SENDER_LOG else wanted}
    viewer = Viewer(command, environment)
    try:
        yield viewer
    finally:
        end_viewer(viewer)


def end_viewer(viewer: subprocess.Popen[bytes]) -> None:
    """End the viewer, even if it is frozen. Does nothing if it has already ended."""
    viewer.terminate()
    try:
        viewer.wait(_GRACE_S)
    except subprocess.TimeoutExpired:
        viewer.kill()
        viewer.wait()


def wait_until_it_listens(viewer: Viewer, url: str) -> None:
    """Wait until the viewer receives data; without this, Rerun itself would wait for seconds. Raises UserError if
    the viewer does not start."""
    port = urlsplit(url).port
    deadline_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < deadline_s:
        if viewer.poll() is not None:
            wait_until_closed(viewer)  # raises the reason
            break
        with contextlib.suppress(OSError), socket.create_connection((LOCAL, port), _PATIENCE_S):
            return
        time.sleep(0.05)
    raise UserError(f"the Rerun viewer did not start{browser_hint()}")


def wait_until_closed(viewer: Viewer) -> None:
    """Wait until the viewer is closed. Raises UserError if it ends for another reason."""
    code = viewer.wait()
    if code:
        end = f"was killed (signal {-code})" if code < 0 else f"failed (exit code {code})"
        if failure_reason := viewer.failure_reason():
            end = failure_reason
        raise UserError(f"the Rerun viewer {end}{browser_hint()}")


def _refuse_taken(port: int) -> None:
    try:
        socket.create_server((LOCAL, port)).close()
    except (OSError, OverflowError) as error:
        raise UserError(
            f"port {port} cannot be used ({error}): end the program that uses it, perhaps a viewer, or give"
            " bc-play other ports: --port, --web-port"
        ) from None
