"""Wake the main thread from any wait when a signal comes, also if the system delivered it to another thread."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Final

from common.interrupts import STOP_SIGNALS, leave_signals_to_main_thread

_TICK_S: Final = 0.02
_END: Final = 0  # no signal has this number


@contextlib.contextmanager
def signals_wake_main_thread() -> Iterator[None]:
    """Make the main thread run the handlers of `STOP_SIGNALS` soon, also while it waits for a process.

    Handlers run only in the main thread, between two bytecodes. In two cases, a Ctrl-C would otherwise have no
    effect until the wait ends by itself: the system delivers the signal to another thread (libraries start threads
    that do not block signals), or the signal comes just before the main thread begins to wait.

    In every thread, Python's C handler immediately writes the signal's number to a pipe
    (https://docs.python.org/3/library/signal.html#signal.set_wakeup_fd). A thread reads the pipe and sends SIGURG
    to the main thread until the main thread runs Python again. The toolkit uses SIGURG for nothing else, and the
    system ignores it by default.

    Outside the main thread, and on Windows, this does nothing.
    """
    if sys.platform == "win32" or threading.current_thread() is not threading.main_thread():
        yield
        return
    receiver, sender = os.pipe()
    os.set_blocking(sender, False)
    main = _MainThread()
    thread = threading.Thread(target=main.wake_at_signals, args=(receiver,), name="signals", daemon=True)
    urgent = signal.signal(signal.SIGURG, main.on_wake)
    wakeup_fd = signal.set_wakeup_fd(sender, warn_on_full_buffer=False)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(wakeup_fd)
        os.write(sender, bytes([_END]))  # closing `sender` is not enough: a forked process may hold it open
        thread.join()
        signal.signal(signal.SIGURG, urgent)
        os.close(receiver)
        os.close(sender)


class _MainThread:
    def __init__(self) -> None:
        self._ident = threading.main_thread().ident or 0
        self._is_awake = True  # not an Event: a handler must not take a lock

    def on_wake(self, number: int, frame: FrameType | None) -> None:
        """The handler of SIGURG. Python has called the handlers of signals with smaller numbers before."""
        self._is_awake = True

    def wake_at_signals(self, receiver: int) -> None:
        leave_signals_to_main_thread()
        while _END not in (numbers := os.read(receiver, 64)):
            self._is_awake = not any(number in numbers for number in STOP_SIGNALS)
            while not self._is_awake:  # again and again: the main thread may have begun to wait in between
                if sys.platform != "win32":  # for mypy: this thread does not run on Windows
                    signal.pthread_kill(self._ident, signal.SIGURG)
                time.sleep(_TICK_S)
