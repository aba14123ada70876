"""Calls that do not depend on each other: made one after the other, or by a cluster (`common.ray_cluster`)."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Annotated, Any, Final, Protocol, TypeVar

import tyro

Result = TypeVar("Result")

_THREADS: Final = 8


RayAddress = Annotated[
    tuple[str, ...] | None, tyro.conf.arg(metavar="[ADDRESS]", help_behavior_hint="(default: none)")
]
"""The flag `--ray [ADDRESS]`: None where it is not given, empty where no address is."""


class Tasks(Protocol):
    """A way to make calls that do not depend on each other."""

    def __call__(
        self,
        function: Callable[..., Result],
        calls: Sequence[tuple[Any, ...]],
        lost: Callable[[int, str], Result] | None = None,
    ) -> Iterator[tuple[int, Result]]:
        """Call `function` with each of the tuples of arguments; yield number and result of each, as they come.

        What one raises is raised, and the rest is not done. A call may be made again where its process died: it
        must give the same result. `lost` is called with the number of a call whose process died each time, and the
        reason, and gives its result; without it, an error is raised.
        """


def one_by_one(
    function: Callable[..., Result],
    calls: Sequence[tuple[Any, ...]],
    lost: Callable[[int, str], Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Make the calls in this process, in their order."""
    for number, arguments in enumerate(calls):
        yield number, function(*arguments)


def in_threads(
    function: Callable[..., Result],
    calls: Sequence[tuple[Any, ...]],
    lost: Callable[[int, str], Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Make several calls at a time in this process, which wait for a store more than they compute."""
    with ThreadPoolExecutor(_THREADS) as pool:
        numbers = {pool.submit(function, *arguments): number for number, arguments in enumerate(calls)}
        try:
            for done in as_completed(numbers):
                yield numbers[done], done.result()
        finally:
            pool.shutdown(cancel_futures=True)


def tasks_of(ray: RayAddress, **options: object) -> contextlib.AbstractContextManager[Tasks]:
    """The way to make calls that `--ray` chooses: one by one without it. `options` are those of Ray's tasks.
    Raises UsageError for an address that is none, ClusterError where no cluster can be reached."""
    if ray is None:
        return contextlib.nullcontext(one_by_one)
    from common.ray_cluster import address_of, cluster_tasks

    return cluster_tasks(address_of(ray), **options)
