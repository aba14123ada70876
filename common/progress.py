"""Progress bars with the rate and the time left, on stderr, gone when the work is done."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

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
        for item in items:
            yield item
            progress.advance(task)
