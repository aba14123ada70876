"""`bc-play` as `common.preview` starts it: it ends with the process that started it."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import threading

from common import UserError
from common.command import INTERRUPTED, run_command
from common.files import final_path
from viz.cli import play
from viz.config import Play
from viz.console import set_program_name

_NAME = "viewer"  # in place of bc-play, which the user has not called


def end_with_parent() -> None:
    """End this process with its parent, which holds the other end of stdin open and writes nothing."""
    while os.read(0, 1024):
        pass
    if sys.platform != "win32":
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)  # it is waiting for the viewer


def _show(config: Play) -> int:
    try:
        return play(config)
    except KeyboardInterrupt:  # ended by the command beside it: not worth a message
        return INTERRUPTED
    except UserError as error:
        if config.save is not None:
            raise
        again = f"bc-play {shlex.quote(str(final_path(config.log)))} --follow"
        another = f"`{again}` opens another one, `{again} --web` in a browser"
        raise UserError(f"{error}; all else goes on without it; {another}") from None


def main() -> None:
    threading.Thread(target=end_with_parent, name="parent", daemon=True).start()
    set_program_name(_NAME)
    run_command(_NAME, Play, _show)
