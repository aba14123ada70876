"""Ctrl-C and `kill` can be noted instead of interrupting, and do afterwards what they did before."""

from __future__ import annotations

import signal
import threading

import pytest

from common.interrupts import SIGHUP, STOP_SIGNALS, stop_signals, uninterrupted


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_a_signal_is_noted_and_interrupts_nothing(number: signal.Signals) -> None:
    before = signal.signal(number, signal.default_int_handler)  # the tests may run under nohup
    try:
        with stop_signals() as stopped:
            assert not stopped.is_set()
            signal.raise_signal(number)
            assert stopped.is_set()
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)


@pytest.mark.skipif(SIGHUP is None, reason="this system has no terminals that hang up")
def test_a_terminal_that_is_closed_is_passed_over_under_nohup() -> None:
    assert SIGHUP is not None
    before = signal.signal(SIGHUP, signal.SIG_IGN)
    try:
        with stop_signals() as stopped:
            signal.raise_signal(SIGHUP)
            assert not stopped.is_set()
    finally:
        signal.signal(SIGHUP, before)


def test_a_second_ctrl_c_interrupts() -> None:
    with stop_signals(), pytest.raises(KeyboardInterrupt):  # noqa: PT012
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)  # a terminal that is closed is often noticed twice
        signal.raise_signal(signal.SIGINT)


def test_a_signal_waits_for_the_end_of_what_must_not_be_interrupted() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012  (it is when it comes that matters)
        with uninterrupted():
            signal.raise_signal(signal.SIGINT)
            done.append("all of it")
        done.append("more")
    assert done == ["all of it"]


def test_an_inner_block_defers_a_signal_for_the_outer_one() -> None:
    with stop_signals() as stopped:
        with uninterrupted():
            signal.raise_signal(signal.SIGTERM)
            assert not stopped.is_set()
        assert stopped.is_set()


def test_an_error_is_reported_and_not_the_signal() -> None:
    with pytest.raises(OSError, match="disk"), uninterrupted():  # noqa: PT012
        signal.raise_signal(signal.SIGINT)
        raise OSError("the disk is full")


def test_a_thread_hears_no_signals_and_changes_none() -> None:
    before = signal.getsignal(signal.SIGINT)
    seen = []

    def work() -> None:
        with stop_signals() as stopped, uninterrupted():
            seen.append((stopped.is_set(), signal.getsignal(signal.SIGINT)))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [(False, before)]
