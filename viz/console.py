"""Messages of bc-play on stderr, with the name bc-play or, as the viewer of another command, with `viewer`."""

from __future__ import annotations

from common import Skipped, UserError, command
from common.output import print_message


class _Program:
    name = "bc-play"


def set_program_name(name: str) -> None:
    """Print messages from now on with `name` instead of bc-play."""
    _Program.name = name


def browser_hint() -> str:
    """The hint that bc-play adds if its viewer fails; empty for the viewer of another command, which has no --web:
    `viz.preview_command` adds a bc-play command instead."""
    return "; or give --web to use a browser instead" if _Program.name == "bc-play" else ""


def print_notice(text: str) -> None:
    print_message(f"{_Program.name}: {text}")


def print_error(error: UserError) -> int:
    return command.print_error(_Program.name, error)


def print_skipped(skipped: Skipped) -> int:
    return command.warn_skipped(skipped, f"{_Program.name}: skipped")
