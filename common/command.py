"""How every `bc-` command runs: flags from a dataclass, one line for an error, the same exit codes.

Exit codes: 0 done, 1 failed, 2 bad usage (`UsageError`), 3 done but something was skipped or lost, 130 stopped by
Ctrl-C.
"""

from __future__ import annotations

import contextlib
import logging
import re
import sys
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from types import FrameType
from typing import Any, Final, NoReturn, TypeVar

import tyro

from common.errors import Skipped, UsageError, UserError
from common.interrupts import Stopping, signals_to
from common.output import LogMessages, end_bar, print_message
from common.streams import drain, end_process, unhurried_streams, why_results_are_lost

DONE, FAILED, BAD_USAGE, DONE_BUT_SKIPPED, INTERRUPTED = 0, 1, 2, 3, 130

Config = TypeVar("Config")

_NO_MEMORY: Final = re.compile(  # PyTorch, OpenCV, C++, Python's threads
    r"can't allocate memory|out of memory|Insufficient memory|bad_alloc|can't start new thread"
)


def warn(text: str) -> int:
    """Print what a person should know before the result is used; the exit code that says so."""
    print_message(text, style="yellow")
    return DONE_BUT_SKIPPED


def complain(prog: str, error: UserError) -> int:
    """Print what went wrong, in one line; the exit code that says so."""
    print_message(str(error), heading=f"{prog}:", style="red")
    return BAD_USAGE if isinstance(error, UsageError) else FAILED


def warn_skipped(skipped: Skipped) -> int:
    """Print what was left out; the exit code that says so."""
    for line in skipped.lines():
        print_message(line, heading="skipped", style="yellow")
    return DONE_BUT_SKIPPED if len(skipped) else DONE


def flags_given(config: object, *names: str) -> str:
    """Those flags of a command that have another value than by default, as they are typed: "--laps, --force"."""
    changed = [name for name in names if getattr(config, name) != getattr(type(config), name)]
    return ", ".join(f"--{name.replace('_', '-')}" for name in changed)


@contextlib.contextmanager
def usage_errors(*kinds: type[Exception]) -> Iterator[None]:
    """Raise UsageError where the block, which looks at values of flags only, raises an error of these kinds."""
    try:
        yield
    except kinds as error:
        raise UsageError(str(error)) from None


def refuse_no_port(flag: str, port: int) -> None:
    """Raise UsageError for what is no port of somebody who listens."""
    if not 0 < port < 65536:
        raise UsageError(f"{flag} {port}: a port is a number from 1 to 65535")


def run_command(
    prog: str,
    config: type[Config],
    action: Callable[[Config], int],
    description: str | None = None,
    default: Callable[[], Config] | None = None,
) -> None:
    """Parse the command line into `config`, call `action`, and exit with what it returns.

    `description` is what `--help` begins with; by default what `config` says of itself. `default` gives what holds
    where there is no flag, if that is not known before.

    Whoever reads the output may stop reading, or go away: it costs the lines alone. Ctrl-C ends the action; a
    second one ends the process, as `kill -9` would: no file is ever half-written under its own name.
    """
    say_how = partial(print_message, "stopping; Ctrl-C again ends at once", heading=f"{prog}:")
    with unhurried_streams(), Stopping(partial(_end_at_once, prog), say_how) as stopping:
        with signals_to(_interrupt), _logging_as_messages():
            try:
                code = _run(prog, config, action, description or config.__doc__, default)
                drain(is_patient=not stopping.is_asked)
            except KeyboardInterrupt:
                code = INTERRUPTED
        if why := why_results_are_lost():
            code = complain(prog, UserError(f"standard output: {why}"))
            drain(is_patient=False)
    sys.exit(code)


@contextlib.contextmanager
def _logging_as_messages() -> Iterator[None]:
    """Where no command runs, `logging` prints as whoever runs us wants."""
    handler = LogMessages(logging.WARNING)
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """`kill` cleans up as Ctrl-C does."""
    raise KeyboardInterrupt


def _end_at_once(prog: str) -> NoReturn:
    try:
        end_bar()
        print_message("ended at once; files that were not finished end in .part", heading=f"{prog}:")
    finally:
        end_process(INTERRUPTED)


def _run(
    prog: str,
    config: type[Config],
    action: Callable[[Config], int],
    about: str | None,
    default: Callable[[], Config] | None,
) -> int:
    kind: type[UserError] = UserError
    try:
        given: dict[str, Any] = {} if default is None else {"default": default()}
        flags = (tyro.conf.FlagCreatePairsOff,)
        return action(tyro.cli(config, prog=prog, description=about, config=flags, **given))
    except UserError as error:
        why: str | None = str(error)
        if isinstance(error, UsageError):
            kind = UsageError
    except SystemExit as ended:  # of tyro: help, or bad usage
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
    except Exception as error:  # a bug, which keeps its traceback; or a library that ran out of memory
        if not _NO_MEMORY.search(str(error)):
            traceback.print_exc()
            return FAILED
        why = _no_memory(error)
    # Only here has the last reference to what was interrupted gone, and a progress bar its end.
    if why is not None:
        return complain(prog, kind(why))
    print_message("stopped", heading=f"{prog}:")
    return INTERRUPTED


def _no_memory(error: Exception) -> str:
    said = str(error).strip().partition("\n")[0]
    why = f" ({said[:200]})" if said else ""
    return f"not enough memory{why}; close other programs, or raise the limit (ulimit -v)"
