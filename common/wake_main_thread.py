"""A signal ends whatever the main thread waits for, whichever thread the system gave it to."""

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
    """Have the main thread run the handlers of `STOP_SIGNALS` soon, also where it waits for a process.

    Handlers run in the main thread only, between two of its steps. The system may give a signal to any thread that
    does not block it, and libraries start such threads; or it comes just before the main thread begins to wait. In
    both cases a Ctrl-C would else be noticed only when the waiting ends by itself.

    Python's C handler writes the number of a signal to a pipe at once, in whichever thread
    (https://docs.python.org/3/library/signal.html#signal.set_wakeup_fd); a thread that reads it sends the main one
    SIGURG, until that runs Python again. Nothing else here uses SIGURG, which is otherwise ignored.

    Outside the main thread, and on Windows, nothing is done.
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
        os.write(sender, bytes([_END]))  # closing it would not do: a forked process may have it, too
        thread.join()
        signal.signal(signal.SIGURG, urgent)
        os.close(receiver)
        os.close(sender)


class _MainThread:
    def __init__(self) -> None:
        self._ident = threading.main_thread().ident or 0
        self._is_awake = True  # no Event: a handler may take no lock

    def on_wake(self, number: int, frame: FrameType | None) -> None:
        """The handler of SIGURG. Those of signals with smaller numbers have been called before it."""
        self._is_awake = True

    def wake_at_signals(self, receiver: int) -> None:
        leave_signals_to_main_thread()
        while _END not in (numbers := os.read(receiver, 64)):
            self._is_awake = not any(number in numbers for number in STOP_SIGNALS)
            while not self._is_awake:  # it may just have begun to wait
                if sys.platform != "win32":  # where no thread of this class is begun
                    signal.pthread_kill(self._ident, signal.SIGURG)
                time.sleep(_TICK_S)
