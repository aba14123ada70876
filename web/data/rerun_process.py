"""The process that serves a log to Rerun's viewer: `bc-play --web` that ends with its parent process."""

from __future__ import annotations

import signal
import sys
import threading

from common.command import run_command
from viz.cli import play
from viz.config import Play
from viz.preview_command import end_with_parent


def main() -> None:
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_SETMASK, ())  # the web server's threads block those that end a command
    threading.Thread(target=end_with_parent, name="parent", daemon=True).start()
    run_command("bc-play", Play, play)
