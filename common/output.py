"""Every line that a command prints passes here: results on stdout, messages on stderr.

Names of files, sessions, topics and whatever else somebody else has chosen are in these lines. Control characters
in them are escaped, so that none moves the cursor, sets the terminal's title or begins a line of its own. Commands
that a line names in backquotes are spelled so that they can be typed here.
"""

from __future__ import annotations

import logging
import os
import re
import shlex
import shutil
import sys
import sysconfig
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Final

from rich.console import Console, ConsoleOptions, RenderableType
from rich.control import Control
from rich.markup import escape
from rich.prompt import Confirm
from rich.segment import ControlType, Segment
from rich.table import Table
from rich.text import Text

from common.errors import printable
from common.streams import unescaped

_COMMAND: Final = re.compile(
    r"(`|&& )"
    r"(bc-(?:record|log|index|train|runs|drive|play|sim|eval|demo|doctor|web)|rerun|pip)"
    r"(?![\w-])"
)
_live_displays: Final[list[Console]] = []  # those with a progress bar on the terminal; the last one is drawn now
_UNLIMITED: Final = 100_000  # columns
_WITHOUT_BAR: Final = Control(  # the line of a progress bar that was not ended, which has hidden the cursor
    ControlType.CARRIAGE_RETURN, (ControlType.ERASE_IN_LINE, 2), ControlType.SHOW_CURSOR
)


def print_result(*lines: str) -> None:
    """Print what a command is for: each is one line of stdout, whatever is in it."""
    # A progress bar on the terminal takes over stdout, so that lines stand above it; not those for a file.
    stream = sys.stdout if sys.stdout.isatty() else unescaped(sys.stdout)
    for line in lines:
        print(safe_line(line), file=stream, flush=True)


def print_message(text: str, *, heading: str = "", style: str = "") -> None:
    """Print one line of stderr; in colour is its heading, or all of it where there is none."""
    start = Text.assemble((heading, style), " ") if heading else Text()
    console = _live_displays[-1] if _live_displays else message_console()  # above a bar, and not behind it
    console.print(start.append(safe_line(text), "" if heading else style), soft_wrap=True)


def print_next(command: str, why: str = "") -> None:
    """Print the last line of a command, on stderr: what to type next, and why."""
    print_message(f"next: `{command}`{why and f': {why}'}")


def ask(question: str) -> bool | None:
    """Ask a person at a terminal: yes or no; None where there is no terminal. Enter alone is no."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None
    return Confirm.ask(escape(safe_line(question)), default=False, console=message_console())


def print_table(*parts: RenderableType) -> None:
    """Print tables and the lines between them, on stdout. Untrusted text in them is `escape(printable(...))`.

    Nothing in them is cut: a terminal gets cells that are folded, a pipe or a file lines as long as they are."""
    # `:car:` in a name is no emoji
    console = _SafeConsole(file=unescaped(sys.stdout), highlight=False, emoji=False)
    is_free = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    for part in parts:
        if isinstance(part, Table):
            if is_free:
                console.width = console.measure(part, options=console.options.update(max_width=_UNLIMITED)).maximum
            fits = _least_width(part, console) <= console.width
            for column in part.columns:
                column.overflow, column.no_wrap = "fold", column.no_wrap and fits
        console.print(part, soft_wrap=is_free and isinstance(part, str))


def plain_table(title: str | None, *headings: str, text: Collection[str] = ()) -> Table:
    """An empty table, narrow enough for a terminal of 80 columns: numbers to the right, and never folded; what is
    under the first heading, and those of `text`, to the left."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for number, heading in enumerate(headings):
        is_text = not number or heading in text
        table.add_column(heading, justify="left" if is_text else "right", no_wrap=not is_text)
    return table


def _least_width(table: Table, console: Console) -> int:
    """The width of the columns that are not to be folded, and of one character for each other."""
    return sum(
        (3 if table.box else 1)
        + max([console.measure(cell).maximum for cell in (column.header, *column.cells) if column.no_wrap] or [1])
        for column in table.columns
    )


def message_console() -> Console:
    """A console on stderr for live displays: progress bars, a status line."""
    return _SafeConsole(file=unescaped(sys.stderr), soft_wrap=True, highlight=False, emoji=False)


def add_live_display(console: Console) -> None:
    """Print messages above what this console draws, until `remove_live_display`."""
    _live_displays.append(console)


def remove_live_display(console: Console) -> None:
    """To be called when what the console drew is gone."""
    if console in _live_displays:
        _live_displays.remove(console)


def clear_live_displays() -> None:
    """Remove what a progress bar that was not ended has left on the terminal."""
    _live_displays.clear()
    message_console().control(_WITHOUT_BAR)


def shell_command(command: str) -> str:
    """A command of this environment as it can be typed in this shell: with its path, if its name is not enough."""
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
        except Exception:  # a record that does not fit its own format
            self.handleError(record)


class _SafeConsole(Console):
    """Escapes control characters in what it is given; its own colours and cursor movements are added later."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield Segment("\n".join(map(printable, segment.text.split("\n"))), segment.style)


def safe_line(text: str) -> str:
    """One line that can be printed, whatever is in `text`; `print_result` and `print_message` do it themselves."""
    return printable(_COMMAND.sub(lambda match: match[1] + shell_command(match[2]), text))
