"""Calls that do not depend on each other: made one after the other, or by a cluster (`common.ray_cluster`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any, Final, Protocol, TypeVar

Result = TypeVar("Result")

_THREADS: Final = 8


class Tasks(Protocol):
    """A way to make calls that do not depend on each other."""

    def __call__(
        self, function: Callable[..., Result], calls: Sequence[tuple[Any, ...]]
    ) -> Iterator[tuple[int, Result]]:
        """Call `function` with each of the tuples of arguments; yield number and result of each, as they come.

        What one raises is raised, and the rest is not done. A call may be made again where its process died: it
        must give the same result.
        """


def one_by_one(function: Callable[..., Result], calls: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Result]]:
    """Make the calls in this process, in their order."""
    for number, arguments in enumerate(calls):
        yield number, function(*arguments)


def in_threads(function: Callable[..., Result], calls: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Result]]:
    """Make several calls at a time in this process, which wait for a store more than they compute."""
    with ThreadPoolExecutor(_THREADS) as pool:
        numbers = {pool.submit(function, *arguments): number for number, arguments in enumerate(calls)}
        try:
            for done in as_completed(numbers):
                yield numbers[done], done.result()
        finally:
            pool.shutdown(cancel_futures=True)
