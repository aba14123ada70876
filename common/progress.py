"""Progress bars with the rate and the time left, on stderr, gone when the work is done."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Self, TypeVar

from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.status import Status

from common.command import stderr

Item = TypeVar("Item")


def progress_bar() -> Progress:
    console = stderr()
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=console,
        transient=True,
        disable=not console.is_interactive,  # it would leave an empty line in a file of messages
    )


def track(items: Iterable[Item], what: str, total: int) -> Iterator[Item]:
    """Pass `items` on while a bar named `what` counts them up to `total`."""
    with progress_bar() as progress:
        task = progress.add_task(what, total=total, note="")
        yield from progress.track(items, total, task_id=task)


class StatusLine:
    """One line on stderr that is rewritten while something without an end goes on; use it as a context manager.

    Where stderr is not a terminal, nothing is shown: a file of messages needs no line twice a second.
    """

    def __init__(self) -> None:
        self._status = Status("", console=stderr())
        self._is_shown = self._status.console.is_interactive

    def show(self, text: str) -> None:
        if self._is_shown:
            self._status.update(escape(text))

    def say(self, text: str) -> None:
        """Show what should be read also where there is no status line: there it is printed."""
        self.show(text)
        if not self._is_shown:
            self._status.console.print(text, markup=False)

    def note(self, text: str) -> None:
        """Print a line that stays, above the status line."""
        self._status.console.print(text, markup=False)

    def __enter__(self) -> Self:
        if self._is_shown:
            self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._status.stop()
