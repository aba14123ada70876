"""Make independent calls: in order, in threads, or on a cluster (`common.ray_cluster`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any, Final, Protocol, TypeVar

Result = TypeVar("Result")

_THREADS: Final = 8


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
