"""What Ctrl-C and `kill` do: they are noted, or put off, so that what must happen together does."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Final

HANG_UP: Final = getattr(signal, "SIGHUP", None)  # None on Windows
STOPPING: Final[tuple[signal.Signals, ...]] = (
    signal.SIGINT,
    signal.SIGTERM,
    *([] if HANG_UP is None else [HANG_UP]),
)
"""What asks a command to end."""


@contextlib.contextmanager
def signals_to(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """SIGINT, SIGTERM and SIGHUP call `handler` in the block, and afterwards again what they did before.

    SIGHUP (the terminal is closed) stays ignored where it was, as under `nohup`.

    Outside the main thread, which alone hears signals, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in STOPPING}
    before = {
        number: previous
        for number, previous in handlers.items()
        if previous is not None and not (number == HANG_UP and previous == signal.SIG_IGN)
    }  # None: not Python's
    try:
        for number in before:
            signal.signal(number, handler)
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


class Stop(threading.Event):
    """Set by the first signal; `again` by the second."""

    def __init__(self) -> None:
        super().__init__()
        self.again = threading.Event()

    def note(self, number: int, frame: FrameType | None) -> None:
        """A signal has come."""
        (self.again if self.is_set() else self).set()


@contextlib.contextmanager
def stop_signals() -> Iterator[Stop]:
    """An event that Ctrl-C and `kill` set, instead of interrupting whatever is going on at that moment.

    Outside the main thread, which alone hears signals, nothing sets it.
    """
    stopped = Stop()
    with signals_to(stopped.note):
        yield stopped


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Nothing stops the block half-way: signals of `STOPPING` that come meanwhile take effect when it is left.

    If anything is raised in the block, that is what its caller hears, and not of the signal: the error may
    name a file that stays. Outside the main thread, which alone hears signals, nothing need be put off.
    """
    came: list[int] = []
    with signals_to(lambda number, frame: came.append(number)):
        yield
    if came:
        signal.raise_signal(came[0])
