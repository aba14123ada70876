"""End a process together with its parent. The parent keeps the process's stdin open and writes nothing to it."""

from __future__ import annotations

import os
import signal
import sys
import threading


def end_with_parent() -> None:
    """Start a thread that ends this process, as `kill` does, when its parent has ended."""
    threading.Thread(target=_end, name="parent", daemon=True).start()


def _end() -> None:
    while os.read(0, 1024):
        pass
    if sys.platform == "win32":
        os.kill(os.getpid(), signal.SIGTERM)
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)  # wakes it from any wait
