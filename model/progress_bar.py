"""Training's progress bar; nothing where stderr is no terminal, or where rich is not installed."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress


class Bar:
    """A bar with the rate and the time left."""

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress = progress

    @contextlib.contextmanager
    def task(self, what: str, total: int, done: int = 0) -> Iterator[Task]:
        """Something that takes a while, of which `done` is done already."""
        if self._progress is None:
            yield Task()
            return
        task = self._progress.add_task(what, total=total, completed=done, note="")
        try:
            yield Task(self._progress, task)
        finally:
            self._progress.remove_task(task)


class Task:
    def __init__(self, progress: Progress | None = None, number: int = 0) -> None:
        self._progress = progress
        self._number = number

    def advance(self, count: int, note: str = "") -> None:
        if self._progress is not None:
            self._progress.update(self._number, advance=count, note=note)  # type: ignore[arg-type]


@contextlib.contextmanager
def open_bar(*, is_shown: bool) -> Iterator[Bar]:
    if not is_shown:
        yield Bar()
        return
    try:
        from common.progress import progress_bar
    except ImportError:
        yield Bar()
        return
    with progress_bar() as progress:
        yield Bar(progress)
