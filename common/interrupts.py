"""Ctrl-C and `kill` put off for a moment, so that what must happen together does."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Nothing stops the block half-way: SIGINT and SIGTERM that come meanwhile take effect when it is left.

    If anything is raised in the block, that is what its caller hears, and not of the signal: the error may
    name a file that stays. Outside the main thread, which alone hears signals, nothing need be put off.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    before = {number: handler for number, handler in handlers.items() if handler is not None}  # None: not Python's
    came: list[int] = []
    try:
        for number in before:
            signal.signal(number, lambda number, frame: came.append(number))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])
