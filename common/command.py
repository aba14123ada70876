"""How every `bc-` command runs: flags from a dataclass, one line for an error, the same exit codes.

Exit codes: 0 done, 1 failed, 2 bad usage, 3 done but something was skipped or lost, 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any, NoReturn, TypeVar

import tyro
from rich.console import Console
from rich.markup import escape

from common.errors import Skipped, UserError, shown
from common.interrupts import STOPPING, signals_to

DONE, FAILED, BAD_USAGE, DONE_BUT_SKIPPED, INTERRUPTED = 0, 1, 2, 3, 130

Config = TypeVar("Config")


def stderr() -> Console:
    """Progress and warnings go here; results go to stdout."""
    return Console(stderr=True, soft_wrap=True, highlight=False, emoji=False)


def stdout() -> Console:
    """For tables; `:car:` in a name is no emoji."""
    return Console(highlight=False, emoji=False)


def warn(text: str) -> int:
    """Print what a person should know before the result is used; the exit code that says so."""
    stderr().print(f"[yellow]{escape(shown(text))}[/]")
    return DONE_BUT_SKIPPED


def complain(prog: str, error: UserError) -> int:
    """Print what went wrong, in one line; the exit code that says so."""
    stderr().print(f"[red]{prog}:[/] {escape(shown(str(error)))}")
    return FAILED


def warn_skipped(skipped: Skipped) -> int:
    """Print what was left out; the exit code that says so."""
    console = stderr()
    for line in skipped.lines():
        console.print(f"[yellow]skipped[/] {escape(line)}")
    return DONE_BUT_SKIPPED if len(skipped) else DONE


def flags_given(config: object, *names: str) -> str:
    """Those flags of a command that have another value than by default, as they are typed: "--laps, --force"."""
    changed = [name for name in names if getattr(config, name) != getattr(type(config), name)]
    return ", ".join(f"--{name.replace('_', '-')}" for name in changed)


def refuse_no_port(flag: str, port: int) -> None:
    """Raise UserError for what is no port of somebody who listens."""
    if not 0 < port < 65536:
        raise UserError(f"{flag} {port}: a port is a number from 1 to 65535")


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """`kill` cleans up as Ctrl-C does. A second signal must not interrupt the cleaning up."""
    for other in STOPPING:
        signal.signal(other, signal.SIG_IGN)
    raise KeyboardInterrupt


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
    """
    with signals_to(_interrupt):
        code = _run(prog, config, action, description or config.__doc__, default)
    sys.exit(code)


def _run(
    prog: str,
    config: type[Config],
    action: Callable[[Config], int],
    about: str | None,
    default: Callable[[], Config] | None,
) -> int:
    for stream in (sys.stdout, sys.stderr):  # a name of any file system can be printed, if escaped
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        given: dict[str, Any] = {} if default is None else {"default": default()}
        flags = (tyro.conf.FlagCreatePairsOff,)
        code = action(tyro.cli(config, prog=prog, description=about, config=flags, **given))
        sys.stdout.flush()
        return code
    except UserError as error:
        why: str | None = str(error)
    except KeyboardInterrupt:
        why = None
    except BrokenPipeError:  # `bc-... | head`: the reader has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except MemoryError:
        why = "not enough memory; close other programs, or allow it more (`ulimit -v`)"
    except OSError as error:
        if error.strerror is None:
            raise
        where = f"{error.filename}: " if error.filename is not None else ""
        why = where + error.strerror
    # Only here has the last reference to what was interrupted gone, and a progress bar its end.
    if why is not None:
        return complain(prog, UserError(why))
    stderr().print(f"{prog}: stopped")
    return INTERRUPTED
