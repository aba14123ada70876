"""Progress bars on stderr, with the count and the time left; they disappear when the work is done.

If stderr is not a terminal, a line is printed every `LINE_EVERY_S` instead.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable, Iterator
from typing import Final, Protocol, Self, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
from rich.status import Status

from common.errors import printable
from common.output import add_live_display, message_console, print_message, remove_live_display

Item = TypeVar("Item")

LINE_EVERY_S: Final = 30.0
MAX_STEPS: Final = 1000  # of a bar: a step takes 8 us, so 100,000 would take almost a second


class Advance(Protocol):
    """Advance a task by `count` steps, and show a note next to the bar."""

    def __call__(self, count: int, note: str = "") -> object: ...


class _Bar(Progress):
    """A progress bar; if stderr is not a terminal, a line every `LINE_EVERY_S`."""

    def __init__(self, *columns: ProgressColumn, console: Console) -> None:
        is_shown = console.is_interactive  # a bar would leave an empty line in a file of messages
        super().__init__(*columns, console=console, transient=True, disable=not is_shown)
        self._has_ended = threading.Event()
        self._printer = threading.Thread(target=self._print_lines, name="progress", daemon=True)

    def start(self) -> None:
        super().start()
        if self.disable:
            self._printer.start()
        else:
            add_live_display(self.console)

    def stop(self) -> None:
        self._has_ended.set()
        remove_live_display(self.console)
        super().stop()

    def _print_lines(self) -> None:
        while not self._has_ended.wait(LINE_EVERY_S):
            for task in self.tasks:
                if task.total and not task.finished:
                    left = f", about {duration_text(task.time_remaining)} left" if task.time_remaining else ""
                    try:
                        print_message(f"{task.description}: {task.percentage:.0f} %{left}")
                    except ValueError:  # the caller has closed stderr
                        return


def duration_text(seconds: float) -> str:
    """Format a duration for people: "40 s", "12 min", "3 h 5 min"."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def progress_bar() -> Progress:
    return _Bar(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
        console=message_console(),
    )


@contextlib.contextmanager
def progress_task(bar: Progress, name: str, total: int | None, completed: int = 0) -> Iterator[Advance]:
    """Show a line of `bar` while the block runs. `completed` of the `total` steps are already done."""
    task = bar.add_task(name, total=total, completed=completed, note="")

    def advance(count: int, note: str = "") -> None:
        bar.update(task, advance=count, note=note)

    try:
        yield advance
    finally:
        bar.remove_task(task)


def track(items: Iterable[Item], description: str, total: int) -> Iterator[Item]:
    """Yield `items`, and count them on a progress bar."""
    with progress_bar() as bar, progress_task(bar, description, total) as advance:
        step = max(1, total // MAX_STEPS)
        for done, item in enumerate(items, 1):  # rich's own `track` does not count if no bar is shown
            yield item
            if done % step == 0:
                advance(step)


class StatusLine:
    """A line on stderr that is rewritten during work of unknown length; use it as a context manager.

    If stderr is not a terminal, nothing is shown: a file of messages needs no line twice a second.
    """

    def __init__(self) -> None:
        self._status = Status("", console=message_console())
        self._is_shown = self._status.console.is_interactive

    def show(self, text: str) -> None:
        if self._is_shown:
            self._status.update(escape(printable(text)))

    def show_or_print(self, text: str) -> None:
        """Show a text; without a terminal, print it."""
        self.show(text)
        if not self._is_shown:
            print_message(text)

    def __enter__(self) -> Self:
        if self._is_shown:
            self._status.start()
            add_live_display(self._status.console)
        return self

    def __exit__(self, *exception: object) -> None:
        remove_live_display(self._status.console)
        self._status.stop()
