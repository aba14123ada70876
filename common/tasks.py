"""Calls that do not depend on each other: made one after the other, or by a cluster (`common.ray_cluster`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol, TypeVar

Result = TypeVar("Result")


class Tasks(Protocol):
    """A way to make calls that do not depend on each other."""

    def __call__(
        self, function: Callable[..., Result], calls: Sequence[tuple[Any, ...]]
    ) -> Iterator[tuple[int, Result]]:
        """Call `function` with each of the tuples of arguments; yield number and result of each, as they come.

        What one raises is raised, and the rest is not done. A call may be made again where its process died: it
        must come to the same.
        """


def one_by_one(function: Callable[..., Result], calls: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Result]]:
    """Make the calls in this process, in their order."""
    for number, arguments in enumerate(calls):
        yield number, function(*arguments)
