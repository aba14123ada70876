"""The process that serves a log to Rerun's viewer: `bc-play --web` that ends with its parent process."""

from __future__ import annotations

import signal
import sys

from common.command import run_command
from common.parent_process import end_with_parent
from viz.cli import play
from viz.config import Play


def main() -> None:
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_SETMASK, ())  # the web server's threads block those that end a command
    end_with_parent()
    run_command("bc-play", Play, play)
