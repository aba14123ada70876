"""Every line that a command prints passes here: results on stdout, messages on stderr.

Names of files, sessions, topics and whatever else somebody else has chosen are in these lines. Control characters
in them are escaped, so that none moves the cursor, sets the terminal's title or begins a line of its own. Commands
that a line names in backquotes are spelled so that they can be typed here.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from rich.console import Console, ConsoleOptions, RenderableType
from rich.control import Control
from rich.markup import escape
from rich.prompt import Confirm
from rich.segment import ControlType, Segment
from rich.text import Text

from common.errors import shown
from common.streams import trusted

_COMMAND: Final = re.compile(
    r"(`|--no-python )(bc-(?:record|log|index|train|drive|play|sim|eval|demo)|rerun|torchrun|pip)(?![\w-])"
)
_drawing: list[Console] = []  # the consoles of bars and status lines that are shown, the last on top
_WITHOUT_BAR: Final = Control(  # the line of a progress bar that was not ended, which has hidden the cursor
    ControlType.CARRIAGE_RETURN, (ControlType.ERASE_IN_LINE, 2), ControlType.SHOW_CURSOR
)


def print_result(*lines: str) -> None:
    """Print what a command is for: each is one line of stdout, whatever is in it."""
    # A progress bar on the terminal takes over stdout, so that lines stand above it; not those for a file.
    stream = sys.stdout if sys.stdout.isatty() else trusted(sys.stdout)
    for line in lines:
        print(safe_line(line), file=stream, flush=True)


def print_message(text: str, *, heading: str = "", style: str = "") -> None:
    """Print one line of stderr; in colour is its heading, or all of it where there is none."""
    start = Text.assemble((heading, style), " ") if heading else Text()
    console = _drawing[-1] if _drawing else message_console()  # above what draws itself, never glued to it
    console.print(start.append(safe_line(text), "" if heading else style))


def ask(question: str) -> bool | None:
    """Yes or no, from a person at a terminal; None where there is none to ask. Enter alone is no."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None
    return Confirm.ask(escape(safe_line(question)), default=False, console=message_console())


def print_table(*parts: RenderableType) -> None:
    """Print tables and the lines between them, on stdout. What is foreign in them is `escape(shown(...))`."""
    console = _SafeConsole(file=trusted(sys.stdout), highlight=False, emoji=False)  # `:car:` in a name is no emoji
    for part in parts:
        console.print(part)


def message_console() -> Console:
    """stderr, for what draws itself there: progress bars, a status line."""
    return _SafeConsole(file=trusted(sys.stderr), soft_wrap=True, highlight=False, emoji=False)


def begins_to_draw(console: Console) -> None:
    """Messages stand above what draws itself by `console`, until `has_drawn`."""
    _drawing.append(console)


def has_drawn(console: Console) -> None:
    if console in _drawing:
        _drawing.remove(console)


def end_bar() -> None:
    """Take away what a progress bar that was not ended has left on the terminal."""
    _drawing.clear()
    message_console().control(_WITHOUT_BAR)


def as_typed(command: str) -> str:
    """A command of this environment as it can be typed here: with its path, if its name is not enough."""
    script = Path(sysconfig.get_path("scripts")) / command
    found = shutil.which(command)
    if not script.exists() or (found is not None and script.samefile(found)):
        return command
    relative = Path(os.path.relpath(script))
    return shlex.quote(str(relative if len(relative.parts) < len(script.parts) else script))


class _SafeConsole(Console):
    """Escapes control characters in what it is given; its own colours and cursor movements are added later."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield Segment("\n".join(map(shown, segment.text.split("\n"))), segment.style)


def safe_line(text: str) -> str:
    """One line that can be printed, whatever is in `text`; `print_result` and `print_message` do it themselves."""
    return shown(_COMMAND.sub(lambda match: match[1] + as_typed(match[2]), text))
