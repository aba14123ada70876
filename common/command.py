"""Run a `bc-` command: flags from a dataclass, errors in one line, the same exit codes for all commands.

Exit codes: 0 done, 1 failed, 2 bad usage (`UsageError`), 3 done but something was skipped or lost, 130 stopped by
Ctrl-C.
"""

from __future__ import annotations

import contextlib
import inspect
import logging
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator
from typing import Any, Final, TypeVar

import tyro

from common.errors import Skipped, UsageError, UserError
from common.flags import asks_for_help, flag_errors_in_one_line, print_help, quick_types, refuse_empty_flags
from common.interrupts import interrupting_signals
from common.location_flag import path_flags
from common.output import MessageHandler, print_message, print_result
from common.streams import command_streams
from common.versions import version_of

DONE, FAILED, BAD_USAGE, DONE_BUT_SKIPPED, INTERRUPTED = 0, 1, 2, 3, 130

Config = TypeVar("Config")

_VERSION_FLAG: Final = "--version prints the version."

_NO_MEMORY: Final = re.compile(  # texts of PyTorch, OpenCV, C++, Python's threads and the loader of libraries
    r"can't allocate memory|out of memory|Insufficient memory|bad_alloc|can't start new thread"
    r"|failed to map segment"
)


def warn(text: str) -> int:
    """Print a warning; return exit code 3."""
    print_message(text, style="yellow")
    return DONE_BUT_SKIPPED


def print_error(prog: str, error: UserError) -> int:
    """Print an error in one line; return its exit code, 1 or 2."""
    print_message(str(error), heading=f"{prog}:", style="red")
    return BAD_USAGE if isinstance(error, UsageError) else FAILED


def warn_skipped(skipped: Skipped, heading: str = "skipped") -> int:
    """Print the skipped items, if there are any; return the exit code, 0 or 3."""
    for line in skipped.lines():
        print_message(line, heading=heading, style="yellow")
    return DONE_BUT_SKIPPED if len(skipped) else DONE


def flags_given(config: object, *names: str) -> str:
    """The flags among `names` whose value is not the default, as the user types them: "--laps, --force"."""
    defaults = {name: getattr(type(config), name) for name in names}
    changed = [name for name in names if getattr(config, name) != defaults[name]]
    return ", ".join(f"--{'no-' * (defaults[name] is True)}{name.replace('_', '-')}" for name in changed)


@contextlib.contextmanager
def usage_errors(*kinds: type[Exception]) -> Iterator[None]:
    """Raise UsageError if the block raises an error of these kinds. The block must only check values of flags."""
    try:
        yield
    except kinds as error:
        raise UsageError(str(error)) from None


def check_port(flag: str, port: int) -> None:
    """Raise UsageError if the number is not a valid port."""
    if not 0 < port < 65536:
        raise UsageError(f"{flag} {port}: a port is a number from 1 to 65535")


def run_command(
    prog: str,
    config: type[Config],
    action: Callable[[Config], int],
    description: str | None = None,
    default: Callable[[], Config | None] | None = None,
) -> None:
    """Parse the command line into `config`, call `action`, and exit with its return value.

    `description` is the beginning of `--help`, by default the docstring of `config`. `default` makes the default
    configuration, if it is not known before; None for that of the dataclass.

    Ctrl-C, `kill` and a closed terminal end the action: files have a temporary name until they are complete.
    """
    _hold_standard_streams()
    with command_streams():
        try:
            with interrupting_signals(), _logging_as_messages():
                about = f"{_paragraphs(description or config.__doc__ or '')}\n\n{_VERSION_FLAG}"
                code = _run(prog, config, action, about, default)
        except KeyboardInterrupt:  # while the command was ending already
            code = INTERRUPTED
    sys.exit(code)


def _hold_standard_streams() -> None:
    """A file that is opened must not get the number of a standard stream that is closed (`2>&-`): libraries print
    there, and would print into it."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free: this one


def _paragraphs(docstring: str) -> str:
    """The text of a docstring, with commands indented."""
    lines = inspect.cleandoc(docstring).splitlines()
    return "\n".join(f"    {line}" if line.startswith("bc-") else line for line in lines)


@contextlib.contextmanager
def _logging_as_messages() -> Iterator[None]:
    """Print records of `logging` as messages while a command runs. A program that imports the toolkit sets its own
    handlers."""
    handler = MessageHandler(logging.WARNING)
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)


def _run(
    prog: str,
    config: type[Config],
    action: Callable[[Config], int],
    about: str,
    default: Callable[[], Config | None] | None,
) -> int:
    kind: type[UserError] = UserError
    try:
        if sys.argv[1:] == ["--version"]:
            print_result(f"{prog} {version_of()}")
            return DONE
        made = None if default is None else default()
        defaults: dict[str, Any] = {} if made is None else {"default": made}
        flags = (tyro.conf.FlagCreatePairsOff,)
        if asks_for_help(sys.argv[1:]):
            with quick_types():
                print_help(prog, config, about, sys.argv[1:], defaults.get("default"))
        with flag_errors_in_one_line(config), quick_types(), path_flags():
            parsed = tyro.cli(config, prog=prog, description=about, config=flags, **defaults)
        refuse_empty_flags(config)
        return action(parsed)
    except UserError as error:
        why: str | None = str(error)
        if isinstance(error, UsageError):
            kind = UsageError
    except SystemExit as ended:  # raised by tyro: help, or bad usage
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except KeyboardInterrupt:
        why = None
    except MemoryError as error:
        why = _no_memory(error)
    except OSError as error:
        if error.strerror is None:
            traceback.print_exc()
            return FAILED
        where = f"{error.filename}: " if error.filename is not None else ""
        why = where + error.strerror
    except Exception as error:  # a bug, which keeps its traceback, or a library that ran out of memory
        if not _NO_MEMORY.search(str(error)):
            traceback.print_exc()
            return FAILED
        why = _no_memory(error)
    # After the `except` block: its end releases the interrupted objects, and erases a progress bar.
    if why is not None:
        return print_error(prog, kind(why))
    print_message("stopped", heading=f"{prog}:")
    return INTERRUPTED


def _no_memory(error: Exception) -> str:
    detail = str(error).strip().partition("\n")[0]
    why = f" ({detail[:200]})" if detail else ""
    return f"not enough memory{why}; close other programs, or raise the limit (ulimit -v)"
