"""Make independent calls: in order, in threads, in processes, or on a cluster (`common.ray_cluster`)."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, MutableSequence, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed, wait
from typing import Any, Final, Protocol, TypeVar

from common.process_settings import usable_cores

Result = TypeVar("Result")

_THREADS: Final = 8
_PROGRESS_EVERY_S: Final = 0.5


class Tasks(Protocol):
    """A function that makes independent calls."""

    def __call__(
        self, function: Callable[..., Result], calls: Sequence[tuple[Any, ...]]
    ) -> Iterator[tuple[int, Result]]:
        """Call `function` with each tuple of arguments; yield (number of the call, result) when a call is done.

        If a call raises an error, the error is raised and the other calls are not made. If a process dies, its
        call is made again: `function` must return the same result for the same arguments.
        """


def one_by_one(function: Callable[..., Result], calls: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Result]]:
    """Make the calls in this process, in order."""
    for number, arguments in enumerate(calls):
        yield number, function(*arguments)


def in_threads(function: Callable[..., Result], calls: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Result]]:
    """Make several calls at the same time in this process. For calls that mostly wait for a store."""
    with ThreadPoolExecutor(_THREADS) as pool:
        numbers = {pool.submit(function, *arguments): number for number, arguments in enumerate(calls)}
        try:
            for done in as_completed(numbers):
                yield numbers[done], done.result()
        finally:
            pool.shutdown(cancel_futures=True)


def in_processes(
    function: Callable[..., Result],
    calls: Sequence[tuple[Any, ...]],
    progress: Callable[[float], object] = lambda done: None,
) -> Iterator[tuple[int, Result]]:
    """Make as many calls at the same time as there are cores, in processes of their own.

    `progress` gets the number of calls that are done, with the shares of others that they report (`report_share`).
    If a call raises an error, or this process is interrupted, the processes get SIGTERM, and the error is raised
    when they have ended. Raises BrokenProcessPool if a process is killed.
    """
    context = multiprocessing.get_context("spawn")
    shares = context.Array("d", len(calls), lock=False)
    count = min(len(calls), usable_cores())
    waiting = list(enumerate(calls))[::-1]
    running: dict[Future[Result], int] = {}
    with ProcessPoolExecutor(count, context, initializer=_begin, initargs=(shares,)) as pool:
        try:
            while waiting or running:
                # only calls that begin now: a pool does not take back what it has queued for its processes
                while waiting and len(running) < count:
                    number, arguments = waiting.pop()
                    running[pool.submit(_call, number, function, arguments)] = number
                for future in wait(running, _PROGRESS_EVERY_S, FIRST_COMPLETED).done:
                    number = running.pop(future)
                    shares[number] = 1.0
                    yield number, future.result()
                progress(sum(shares))
        finally:
            if running:
                for process in multiprocessing.active_children():
                    process.terminate()


class _Own:
    """In a process of `in_processes`: its current call, and the shares of all calls that are done."""

    number = 0
    shares: MutableSequence[float] | None = None


def _begin(shares: MutableSequence[float]) -> None:
    _Own.shares = shares


def _call(number: int, function: Callable[..., Result], arguments: tuple[Any, ...]) -> Result:
    _Own.number = number
    return function(*arguments)


def report_share(done: float) -> None:
    """Report the share of the current call that is done, 0 to 1, to `in_processes`; elsewhere, do nothing."""
    if _Own.shares is not None:
        _Own.shares[_Own.number] = done
