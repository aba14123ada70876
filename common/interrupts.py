"""Ctrl-C and `kill`: SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt, or set an event in loops that end by
themselves.

Only the main thread receives signals. In other threads, nothing here has an effect.
"""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Final

SIGHUP: Final = getattr(signal, "SIGHUP", None)  # None on Windows
STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, *filter(None, [SIGHUP]))

_TICK_S: Final = 0.02

_is_stopped = False


class StopEvent(threading.Event):
    """An event that the first signal sets. The second one sets `again`, if the block wants two."""

    def __init__(self) -> None:
        super().__init__()
        self.again = threading.Event()
        self.signal: int | None = None  # the first one

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the event is set, or `timeout` seconds have passed; return whether it is set.

        This polls: `Event.wait` holds a lock, and a handler that interrupts it would wait for this lock.
        """
        end_s = math.inf if timeout is None else time.monotonic() + timeout
        while not self.is_set() and (left_s := end_s - time.monotonic()) > 0:
            time.sleep(min(left_s, _TICK_S))
        return self.is_set()


@contextlib.contextmanager
def stop_signals(max_signals: int = 1) -> Iterator[StopEvent]:
    """Yield an event that Ctrl-C and `kill` set, instead of interrupting the running code. After `max_signals`
    signals, Ctrl-C raises KeyboardInterrupt.

    SIGHUP (the terminal is closed) stays ignored if it was ignored before, as under `nohup`.
    """
    stopped, received = StopEvent(), 0

    def note(number: int, frame: FrameType | None) -> None:
        global _is_stopped
        nonlocal received
        if received and number != signal.SIGINT:  # often sent twice: by a closed terminal, and by its shell
            return
        received += 1
        _is_stopped = True
        if received > max_signals:
            raise KeyboardInterrupt
        stopped.signal = stopped.signal or number
        (stopped if received == 1 else stopped.again).set()

    before = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for number in STOP_SIGNALS:
                handler = signal.getsignal(number)
                if handler is not None and not (number == SIGHUP and handler == signal.SIG_IGN):
                    before[number] = handler  # None: not set by Python
                    signal.signal(number, note)
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def interrupting_signals() -> Iterator[None]:
    """The block of a command: `kill` and a closed terminal raise KeyboardInterrupt, as Ctrl-C does."""
    global _is_stopped
    _is_stopped = False
    with stop_signals(max_signals=0):
        yield


def is_command_stopped() -> bool:
    """True if the command has received a signal."""
    return _is_stopped


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Postpone the first signal until the block has run to its end.

    If the block raises an error, the error is raised and the signal is dropped: the error may name a file that
    stays.
    """
    with stop_signals() as stopped:
        yield
    if stopped.signal is not None:
        signal.raise_signal(stopped.signal)
