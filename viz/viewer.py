"""The Rerun viewer as a process of its own, listening on this machine only."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import rerun_cli

LOCAL: Final = "127.0.0.1"


def has_display() -> bool:
    """Whether a window can open here."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def viewer_program() -> Path:
    """The viewer itself. `rerun` is a Python wrapper, and killing that would leave the viewer alone."""
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    return Path(rerun_cli.__file__).parent / name


@contextlib.contextmanager
def open_viewer(rrd: Path, *, web: bool, web_port: int, port: int) -> Iterator[subprocess.Popen[bytes]]:
    """Open `rrd` in a window, or serve it to browsers on this machine; the viewer ends with the context."""
    command = [str(viewer_program()), str(rrd), "--bind", LOCAL]
    if web:
        command += ["--serve-web", "--web-viewer-port", str(web_port), "--port", str(port)]
    else:
        command += ["--port", "auto"]  # a window of its own, also beside another viewer
    viewer = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        yield viewer
    finally:
        viewer.terminate()
        viewer.wait()


def web_address(web_port: int, port: int) -> str:
    """What to open in a browser."""
    return f"http://{LOCAL}:{web_port}/?url=rerun%2Bhttp://{LOCAL}:{port}/proxy"
