"""Messages of bc-play on stderr, under its own name or, beside another command, under that of its viewer."""

from __future__ import annotations

from common import Skipped, UserError, command
from common.output import print_message


class _Program:
    name = "bc-play"


def set_program_name(name: str) -> None:
    """Print messages from now on under this name instead of bc-play's."""
    _Program.name = name


def browser_hint() -> str:
    """A hint that bc-play adds where its viewer fails. Beside another command, which has no such flag,
    `viz.preview_command` adds the bc-play command that shows the same."""
    return "; or give --web to use a browser instead" if _Program.name == "bc-play" else ""


def print_notice(text: str) -> None:
    print_message(f"{_Program.name}: {text}")


def print_error(error: UserError) -> int:
    """Print an error in one line; return its exit code."""
    return command.print_error(_Program.name, error)


def print_skipped(skipped: Skipped) -> int:
    """Print the items that are not shown, if any; return the exit code."""
    return command.warn_skipped(skipped, f"{_Program.name}: skipped")
