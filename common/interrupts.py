"""What Ctrl-C and `kill` do: they are noted, or put off, so that what must happen together does.

Who presses Ctrl-C a second time wants no more tidying up. The process then ends as by `kill -9`, also in the
middle of what is otherwise `uninterrupted`: whatever is written is made for that (a temporary name, one rename in
the end), because a power cut does the same. Other signals come several times by themselves (a closed terminal
sends SIGHUP, its shell another one), so that only a Ctrl-C counts as a second wish.
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
from types import FrameType, TracebackType
from typing import ClassVar, Final, Self

HANG_UP: Final = getattr(signal, "SIGHUP", None)  # None on Windows
STOPPING: Final[tuple[signal.Signals, ...]] = (
    signal.SIGINT,
    signal.SIGTERM,
    *([] if HANG_UP is None else [HANG_UP]),
)
"""What asks a command to end."""

SLOW_S: Final = 2.0
"""What takes longer to end says how it is ended at once."""

_TICK_S: Final = 0.02


def leave_signals_to_main_thread() -> None:
    """To be called in a thread that waits a lot: a signal that the system gives to it would not wake the main one,
    which alone runs handlers."""
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)


class _Heard(Enum):
    """What the thread of a `Stopping` hears."""

    ASKED = "the first signal has come"
    SAID = "how the command is ended at once was said"
    LOST = "what a handler raised went no further"
    ENDED = "the command has ended"


class Stopping:
    """In this block, which is a whole command, the first signal that `signals_to` hears asks for the end, and a
    Ctrl-C that no handler takes any more calls `at_once`, which must not return."""

    current: ClassVar[Stopping | None] = None

    def __init__(self, at_once: Callable[[], object], on_slow: Callable[[], object]) -> None:
        """`on_slow` is called, in a thread, if the block has not ended `SLOW_S` after the first signal."""
        self._heard = 0
        self._at_once = at_once
        self._on_slow = on_slow
        # a handler may take no lock: whom it interrupts may have it
        self._told: SimpleQueue[_Heard] = SimpleQueue()
        self._is_repeated = False
        self._unraisable = sys.unraisablehook

    @property
    def is_asked(self) -> bool:
        return self._heard > 0

    def heard(self, number: int, most: int) -> bool:
        """Whether a handler that takes `most` signals is to be told of this one."""
        if self._is_repeated:
            self._is_repeated = False
            return True
        if self.is_asked and number != signal.SIGINT:
            return False
        if self._heard >= most:
            self._at_once()
        if not self.is_asked:
            self._told.put(_Heard.ASKED)
        self._heard += 1
        return True

    def was_said(self) -> None:
        """The command itself has said how it is ended at once: `on_slow` need not."""
        if self.is_asked:
            self._told.put(_Heard.SAID)

    def repeat(self) -> None:
        """The next signal is one that was heard before, and put off."""
        self._is_repeated = True

    def __enter__(self) -> Self:
        Stopping.current = self
        self._unraisable, sys.unraisablehook = sys.unraisablehook, self._hear_of_lost
        threading.Thread(target=self._watch, name="stopping", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        Stopping.current = None
        sys.unraisablehook = self._unraisable
        self._told.put(_Heard.ENDED)

    def _hear_of_lost(self, what: sys.UnraisableHookArgs) -> None:
        """What is raised where Python tidies up goes no further, and a handler may be called there (`__del__`, a
        callback of a weak reference) as anywhere else."""
        if self.is_asked and issubclass(what.exc_type, KeyboardInterrupt):
            self._told.put(_Heard.LOST)
        else:
            self._unraisable(what)

    def _watch(self) -> None:
        leave_signals_to_main_thread()
        patience_s: float | None = None
        while True:
            try:
                heard = self._told.get(timeout=patience_s)
            except Empty:
                self._on_slow()
                patience_s = None
                continue
            if heard is _Heard.ENDED:
                return
            if heard is _Heard.LOST:
                self.repeat()
                _interrupt_main_thread()
            patience_s = None if heard is _Heard.SAID else SLOW_S


def _interrupt_main_thread() -> None:
    if sys.platform == "win32":
        _thread.interrupt_main()
    elif (main := threading.main_thread().ident) is not None:
        signal.pthread_kill(main, signal.SIGINT)  # wakes it, whatever it waits for


def way_out_was_said() -> None:
    """To be called where a command has said how a second Ctrl-C ends it at once."""
    if Stopping.current is not None:
        Stopping.current.was_said()


@contextlib.contextmanager
def signals_to(handler: Callable[[int, FrameType | None], object], most: int = 1) -> Iterator[None]:
    """SIGINT, SIGTERM and SIGHUP call `handler` in the block, and afterwards again what they did before.

    In a command (`Stopping`), it is called `most` times; a Ctrl-C after that ends the process.

    SIGHUP (the terminal is closed) stays ignored where it was, as under `nohup`.

    Outside the main thread, which alone hears signals, nothing is changed.
    """

    def hear(number: int, frame: FrameType | None) -> None:
        if Stopping.current is None or Stopping.current.heard(number, most):
            handler(number, frame)

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
            signal.signal(number, hear)
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


class Stop(threading.Event):
    """Set by the first signal; `again` by the second."""

    def __init__(self) -> None:
        super().__init__()
        self.again = threading.Event()

    def wait(self, timeout: float | None = None) -> bool:
        """Whether it is set, at most `timeout` seconds from now.

        It looks again and again: a handler that interrupted `Event.wait` would wait for the lock that this holds.
        """
        end_s = math.inf if timeout is None else time.monotonic() + timeout
        while not self.is_set() and (left_s := end_s - time.monotonic()) > 0:
            time.sleep(min(left_s, _TICK_S))
        return self.is_set()

    def note(self, number: int, frame: FrameType | None) -> None:
        """A signal has come."""
        (self.again if self.is_set() else self).set()


@contextlib.contextmanager
def stop_signals(most: int = 1) -> Iterator[Stop]:
    """An event that Ctrl-C and `kill` set, instead of interrupting whatever is going on at that moment.

    With `most` 2, a second Ctrl-C sets `again`; the next one ends the process.

    Outside the main thread, which alone hears signals, nothing sets it.
    """
    stopped = Stop()
    with signals_to(stopped.note, most):
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
        if Stopping.current is not None:
            Stopping.current.repeat()
        signal.raise_signal(came[0])
