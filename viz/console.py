"""What is said on stderr while something is shown, and under which name: beside another command, as its viewer."""

from __future__ import annotations

from common import Skipped, UserError, command
from common.command import DONE, DONE_BUT_SKIPPED
from common.output import print_message


class _Speaker:
    of_its_own = "bc-play"
    name = of_its_own


def speak_as(name: str) -> None:
    """Say all from now on under this name instead of bc-play's."""
    _Speaker.name = name


def or_in_a_browser() -> str:
    """What bc-play adds where its viewer fails. Beside another command, which has no such flag,
    `viz.preview_command` adds the bc-play command that shows the same."""
    return "; or give --web to use a browser instead" if _Speaker.name == _Speaker.of_its_own else ""


def say(text: str) -> None:
    print_message(f"{_Speaker.name}: {text}")


def complain(error: UserError) -> int:
    """Print what went wrong, in one line; the exit code that says so."""
    return command.complain(_Speaker.name, error)


def say_skipped(skipped: Skipped) -> int:
    """Print what was left out of what is shown; the exit code that says so."""
    for line in skipped.lines():
        print_message(line, heading=f"{_Speaker.name}: skipped", style="yellow")
    return DONE_BUT_SKIPPED if len(skipped) else DONE
