"""Print every line of a command: results on stdout, messages on stderr.

The lines contain untrusted names (of files, sessions, topics). Their control characters are escaped, so that none
moves the cursor, sets the terminal's title or begins a new line. Commands in backquotes are spelled so that the
user can type them in this shell.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import shlex
import shutil
import sys
import sysconfig
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Final, TextIO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.control import Control
from rich.markup import escape
from rich.prompt import Confirm
from rich.segment import ControlType, Segment
from rich.table import Table
from rich.text import Text

from common.errors import printable

_COMMAND: Final = re.compile(
    r"(`|&& )"
    r"(bc-(?:record|log|index|train|runs|drive|play|sim|eval|demo|doctor|web)|rerun|pip)"
    r"(?![\w-])"
)
_live_displays: Final[list[Console]] = []  # consoles with a progress bar or a status line; the last one is drawn
_UNLIMITED: Final = 100_000  # columns
_WITHOUT_BAR: Final = Control(  # erases the line of an interrupted progress bar, and shows the cursor again
    ControlType.CARRIAGE_RETURN, (ControlType.ERASE_IN_LINE, 2), ControlType.SHOW_CURSOR
)


def print_result(*lines: str) -> None:
    """Print results on stdout, each in one line."""
    # On a terminal, a progress bar has replaced stdout and prints lines above the bar; a file gets plain lines.
    stream = sys.stdout if sys.stdout.isatty() else _without_bar(sys.stdout)
    for line in lines:
        print(safe_line(line), file=stream, flush=True)


def print_message(text: str, *, heading: str = "", style: str = "") -> None:
    """Print one line on stderr. `style` colours the heading, or the whole line if it has no heading."""
    start = Text.assemble((heading, style), " ") if heading else Text()
    console = _live_displays[-1] if _live_displays else message_console()  # prints above a progress bar
    console.print(start.append(safe_line(text), "" if heading else style), soft_wrap=True)


def print_next(command: str, why: str = "") -> None:
    """Print the last line of a command, on stderr: the next command, and the reason."""
    print_message(f"next: `{command}`{why and f': {why}'}")


def ask(question: str) -> bool | None:
    """Ask a yes-or-no question at the terminal; None without a terminal. Enter alone and Ctrl-D mean no."""
    if sys.stdin is None or not (sys.stdin.isatty() and sys.stderr.isatty()):  # None: closed from the start
        return None
    with contextlib.suppress(EOFError):
        return Confirm.ask(escape(safe_line(question)), default=False, console=message_console())
    return False


def prints_unicode() -> bool:
    """True if the encoding of stdout has all characters."""
    return (sys.stdout.encoding or "utf-8").lower().startswith("utf")


def print_table(*parts: RenderableType) -> None:
    """Print tables, and lines between them, on stdout. Pass untrusted text through `escape(printable(...))`.

    Nothing is cut: cells are folded on a terminal; lines have any length in a pipe or a file."""
    # emoji: `:car:` in a name stays text
    console = _SafeConsole(file=_without_bar(sys.stdout), highlight=False, emoji=False)
    is_free = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    for part in parts:
        if isinstance(part, Table):
            if is_free:
                console.width = console.measure(part, options=console.options.update(max_width=_UNLIMITED)).maximum
            fits = _min_width(part, console) <= console.width
            for column in part.columns:
                column.overflow, column.no_wrap = "fold", column.no_wrap and fits
        console.print(part, soft_wrap=is_free and isinstance(part, str))


def plain_table(title: str | None, *headings: str, text: Collection[str] = ()) -> Table:
    """An empty table for a terminal of 80 columns. The first column and the columns in `text` are aligned left;
    the others hold numbers, are aligned right and are never folded."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for number, heading in enumerate(headings):
        is_text = not number or heading in text
        table.add_column(heading, justify="left" if is_text else "right", no_wrap=not is_text)
    return table


def _min_width(table: Table, console: Console) -> int:
    """The width of the columns that must not be folded, plus one character for each of the others."""
    return sum(
        (3 if table.box else 1)
        + max([console.measure(cell).maximum for cell in (column.header, *column.cells) if column.no_wrap] or [1])
        for column in table.columns
    )


def message_console() -> Console:
    """A console on stderr for live displays: progress bars, a status line."""
    return _SafeConsole(file=_without_bar(sys.stderr), soft_wrap=True, highlight=False, emoji=False)


def add_live_display(console: Console) -> None:
    """Print messages above what this console draws, until `remove_live_display`."""
    _live_displays.append(console)


def remove_live_display(console: Console) -> None:
    """Call this when the live display has been erased."""
    if console in _live_displays:
        _live_displays.remove(console)


def _without_bar(stream: TextIO) -> TextIO:
    """The stream that a progress bar has replaced."""
    beneath: TextIO = getattr(stream, "rich_proxied_file", stream)
    return beneath


def clear_live_displays() -> None:
    """Erase the rest of an interrupted progress bar from the terminal."""
    _live_displays.clear()
    message_console().control(_WITHOUT_BAR)


def shell_command(command: str) -> str:
    """A command of this environment, as the user can type it: with its path if the shell would not find it."""
    script = Path(sysconfig.get_path("scripts")) / command
    on_path = shutil.which(command)
    if not script.exists() or (on_path is not None and script.samefile(on_path)):
        return command
    relative = Path(os.path.relpath(script))
    return shlex.quote(str(relative if len(relative.parts) < len(script.parts) else script))


class MessageHandler(logging.Handler):
    """Prints records of Python's `logging` as messages, one line each."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            print_message(self.format(record))
        except Exception:  # the record's arguments do not match its format
            self.handleError(record)


class _SafeConsole(Console):
    """Escapes control characters in the printed text. Colours and cursor movements are added later."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield Segment("\n".join(map(printable, segment.text.split("\n"))), segment.style)


def safe_line(text: str) -> str:
    """`text` as one printable line. `print_result` and `print_message` call this themselves."""
    return printable(_COMMAND.sub(lambda match: match[1] + shell_command(match[2]), text))
