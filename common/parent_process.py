"""The end of a process with its parent, which holds the other end of its stdin open and writes nothing."""

from __future__ import annotations

import os
import signal
import sys
import threading


def end_with_parent() -> None:
    """From now on, a thread ends this process as `kill` does, once its parent has ended."""
    threading.Thread(target=_end, name="parent", daemon=True).start()


def _end() -> None:
    while os.read(0, 1024):
        pass
    if sys.platform == "win32":
        os.kill(os.getpid(), signal.SIGTERM)
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)  # whatever that waits for
