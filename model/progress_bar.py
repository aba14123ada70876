"""The progress bar of training and evaluation: a line for each task, with its rate and the time left."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Protocol

from rich.progress import Progress


class Advance(Protocol):
    """Count so many more steps of a task as done, and show a note beside them."""

    def __call__(self, count: int, note: str = "") -> object: ...


@contextlib.contextmanager
def progress_task(bar: Progress, name: str, total: int, completed: int = 0) -> Iterator[Advance]:
    """A line of `bar`, there while the block runs; of `total` steps, `completed` are done already."""
    task = bar.add_task(name, total=total, completed=completed, note="")

    def advance(count: int, note: str = "") -> None:
        bar.update(task, advance=count, note=note)

    try:
        yield advance
    finally:
        bar.remove_task(task)
