"""`bc-play` as `common.preview` starts it: it ends when who started it has ended, however that was."""

from __future__ import annotations

import os
import signal
import sys
import threading

from viz.cli import main


def _end_with_parent() -> None:
    """Who started it holds the other end of stdin, and writes nothing: its end is the end of that process."""
    while os.read(0, 1024):
        pass
    if sys.platform != "win32":
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)  # it is waiting for the viewer


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    main()
