"""The viewer beside a command that writes what it shows."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

_GRACE_S: Final = 2.0  # for it to end by itself


@contextlib.contextmanager
def preview(growing: Path) -> Iterator[None]:
    """Show a log that is being written, or the folder of a run that is (or will be) trained, while this lasts.

    The viewer is a program of its own: it may freeze, or be closed, and whoever writes goes on. It is in a process
    group of its own, so that nothing of it stays when it does not hear that it shall end.
    """
    line = [sys.executable, "-m", "viz.cli", str(growing), "--follow"]
    viewer = subprocess.Popen(line, stdout=sys.stderr, start_new_session=True)
    try:
        yield
    finally:
        viewer.terminate()
        try:
            viewer.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            pass
        finally:  # also after a second Ctrl-C
            if sys.platform != "win32":
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(viewer.pid, signal.SIGKILL)
            viewer.kill()
            viewer.wait()
