"""Ctrl-C and `kill`: graceful shutdown on the first signal, and blocks that no signal interrupts.

A second Ctrl-C ends the process at once, as `kill -9` does, also in an `uninterrupted` block. No file is damaged:
files are written under a temporary name and then renamed, because a power cut may come at any time. Only a Ctrl-C
counts as a second request: other signals are often sent twice (a closed terminal sends SIGHUP, and so does its
shell).
"""

from __future__ import annotations

import _thread
import contextlib
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from enum import Enum
from queue import Empty, SimpleQueue
from types import FrameType
from typing import ClassVar, Final, Self

SIGHUP: Final = getattr(signal, "SIGHUP", None)  # None on Windows
STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, *filter(None, [SIGHUP]))
"""The signals that ask a command to end."""

FORCE_QUIT_HINT_AFTER_S: Final = 2.0
"""If a command takes longer to end, it announces that a second Ctrl-C ends it at once."""

_TICK_S: Final = 0.02


def leave_signals_to_main_thread() -> None:
    """Block `STOP_SIGNALS` in the calling thread. Call this in threads that mostly wait: only the main thread runs
    handlers, and a signal delivered to another thread does not wake it."""
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)


class _Event(Enum):
    REQUESTED = "the first signal has come"
    ANNOUNCED = "how the command is ended at once was printed"
    LOST = "Python dropped what a handler raised"
    ENDED = "the command has ended"


class GracefulStop:
    """A context manager around a whole command. The first signal that `handle_signals` receives requests the end.
    After `max_signals` signals (see `receive`), the next Ctrl-C calls `force_quit`, which must not return."""

    current: ClassVar[GracefulStop | None] = None

    def __init__(self, force_quit: Callable[[], object], on_slow: Callable[[], object]) -> None:
        """A thread calls `on_slow` if the block still runs `FORCE_QUIT_HINT_AFTER_S` after the first signal."""
        self._received = 0
        self._force_quit = force_quit
        self._on_slow = on_slow
        # a handler must not take a lock: the interrupted code may hold it
        self._events: SimpleQueue[_Event] = SimpleQueue()
        self._is_repeated = False
        self._unraisable = sys.unraisablehook

    @property
    def is_requested(self) -> bool:
        return self._received > 0

    def receive(self, number: int, max_signals: int) -> bool:
        """True if the handler is to be called for this signal. It accepts at most `max_signals` signals."""
        if self._is_repeated:
            self._is_repeated = False
            return True
        if self.is_requested and number != signal.SIGINT:
            return False
        if self._received >= max_signals:
            self._force_quit()
        if not self.is_requested:
            self._events.put(_Event.REQUESTED)
        self._received += 1
        return True

    def announced(self) -> None:
        """Call this when the command has announced the second Ctrl-C: `on_slow` is then not called."""
        if self.is_requested:
            self._events.put(_Event.ANNOUNCED)

    def repeat(self) -> None:
        """Call this before raising a postponed signal again."""
        self._is_repeated = True

    def __enter__(self) -> Self:
        GracefulStop.current = self
        self._unraisable, sys.unraisablehook = sys.unraisablehook, self._on_unraisable
        threading.Thread(target=self._watch, name="stopping", daemon=True).start()
        return self

    def __exit__(self, *exception: object) -> None:
        GracefulStop.current = None
        sys.unraisablehook = self._unraisable
        self._events.put(_Event.ENDED)

    def _on_unraisable(self, unraisable: sys.UnraisableHookArgs) -> None:
        """Notice a lost KeyboardInterrupt: a handler may run in `__del__` or in a weak reference's callback, where
        Python drops exceptions."""
        if self.is_requested and issubclass(unraisable.exc_type, KeyboardInterrupt):
            self._events.put(_Event.LOST)
        else:
            self._unraisable(unraisable)

    def _watch(self) -> None:
        leave_signals_to_main_thread()
        patience_s: float | None = None
        while True:
            try:
                event = self._events.get(timeout=patience_s)
            except Empty:
                self._on_slow()
                patience_s = None
                continue
            if event is _Event.ENDED:
                return
            if event is _Event.LOST:
                self.repeat()
                _interrupt_main_thread()
            patience_s = None if event is _Event.ANNOUNCED else FORCE_QUIT_HINT_AFTER_S


def _interrupt_main_thread() -> None:
    if sys.platform == "win32":
        _thread.interrupt_main()
    elif (main := threading.main_thread().ident) is not None:
        signal.pthread_kill(main, signal.SIGINT)  # wakes the main thread from any wait


def force_quit_announced() -> None:
    """Call this when a command has announced that a second Ctrl-C ends it at once."""
    if GracefulStop.current is not None:
        GracefulStop.current.announced()


@contextlib.contextmanager
def handle_signals(handler: Callable[[int, FrameType | None], object], max_signals: int = 1) -> Iterator[None]:
    """Call `handler` on SIGINT, SIGTERM and SIGHUP in the block; restore the previous handlers afterwards.

    In a command (`GracefulStop`), `handler` is called at most `max_signals` times; the next Ctrl-C ends the
    process.

    SIGHUP (the terminal is closed) stays ignored if it was ignored before, as under `nohup`.

    Outside the main thread, which alone receives signals, this does nothing.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        if GracefulStop.current is None or GracefulStop.current.receive(number, max_signals):
            handler(number, frame)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    before = {
        number: previous
        for number, previous in handlers.items()
        if previous is not None and not (number == SIGHUP and previous == signal.SIG_IGN)
    }  # None: the handler was not set by Python
    try:
        for number in before:
            signal.signal(number, handle)
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


class StopEvent(threading.Event):
    """An event that the first signal sets; the second signal sets `again`."""

    def __init__(self) -> None:
        super().__init__()
        self.again = threading.Event()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the event is set, or `timeout` seconds have passed; return whether it is set.

        This polls: `Event.wait` holds a lock, and a handler that interrupts it would wait for this lock.
        """
        end_s = math.inf if timeout is None else time.monotonic() + timeout
        while not self.is_set() and (left_s := end_s - time.monotonic()) > 0:
            time.sleep(min(left_s, _TICK_S))
        return self.is_set()

    def note(self, number: int, frame: FrameType | None) -> None:
        (self.again if self.is_set() else self).set()


@contextlib.contextmanager
def stop_signals(max_signals: int = 1) -> Iterator[StopEvent]:
    """Yield an event that Ctrl-C and `kill` set, instead of interrupting the running code.

    With `max_signals` 2, a second Ctrl-C sets `again`; the next one ends the process.

    Outside the main thread, which alone receives signals, nothing sets it.
    """
    stopped = StopEvent()
    with handle_signals(stopped.note, max_signals):
        yield stopped


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Postpone the signals of `STOP_SIGNALS` until the block has run to its end.

    If the block raises an error, the error is raised and the signal is dropped: the error may name a file that
    stays. Outside the main thread, which alone receives signals, this does nothing.
    """
    received: list[int] = []
    with handle_signals(lambda number, frame: received.append(number)):
        yield
    if received:
        if GracefulStop.current is not None:
            GracefulStop.current.repeat()
        signal.raise_signal(received[0])
