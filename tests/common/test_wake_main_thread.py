"""Ctrl-C ends what waits, whichever thread of the process the system gives the signal to."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from types import FrameType

import pytest

from common.interrupts import STOP_SIGNALS, handle_signals
from common.wake_main_thread import signals_wake_main_thread
from tests.helpers.waiting import PATIENCE_S

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no thread is given signals there")


class StopError(Exception):
    pass


def stop(number: int, frame: FrameType | None) -> None:
    raise StopError


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_a_signal_of_another_thread_ends_what_the_main_one_waits_for(number: signal.Signals) -> None:
    before = signal.signal(number, signal.default_int_handler)  # the tests may run under nohup
    urgent = signal.getsignal(signal.SIGURG)
    forever = subprocess.Popen([sys.executable, "-c", f"import time; time.sleep({PATIENCE_S})"])
    # given when the main thread waits, or just before that
    other = threading.Timer(0.2, lambda: signal.pthread_kill(threading.get_ident(), number))
    try:
        with signals_wake_main_thread(), handle_signals(stop), pytest.raises(StopError):  # noqa: PT012
            other.start()
            forever.wait()
        assert forever.poll() is None
    finally:
        forever.kill()
        forever.wait()
        signal.signal(number, before)
    assert signal.getsignal(signal.SIGURG) is urgent
    assert signal.set_wakeup_fd(-1) == -1


def test_what_is_not_asked_to_end_is_not_disturbed() -> None:
    heard: list[int] = []
    with signals_wake_main_thread():
        before = signal.signal(signal.SIGUSR1, lambda number, frame: heard.append(number))
        try:
            signal.raise_signal(signal.SIGUSR1)
        finally:
            signal.signal(signal.SIGUSR1, before)
    assert heard == [signal.SIGUSR1]


def test_outside_the_main_thread_nothing_is_changed() -> None:
    seen = []

    def work() -> None:
        with signals_wake_main_thread():
            seen.append(signal.getsignal(signal.SIGURG))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGURG)]
