"""The page of a wheel: bc-web beside the command that drives, in a process of its own."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from common.command import warn
from common.errors import UserError
from common.interrupts import GracefulStop, stop_signals
from common.location import Location
from common.output import print_message
from common.versions import install_line

_PAGE: Final = ("-P", "-c", "from behavioural_cloning_toolkit import wheel_page; wheel_page()")
_END_S: Final = 2.0  # for it to end by itself


def check_wheel_page() -> None:
    """Raise UserError if bc-web is not installed, without which nobody can steer."""
    if missing := [name for name in ("starlette", "uvicorn", "jinja2") if find_spec(name) is None]:
        raise UserError(
            f"{missing[0]} is not installed, but --driver me needs a page: `{install_line('web')}` brings it"
        )


@contextlib.contextmanager
def wheel_page(key: str, folders: Mapping[str, Location], *, opens: bool) -> Iterator[None]:
    """Serve the page of that wheel while this lasts. It prints its address, and `opens` opens it in a browser.
    `folders` are the project's, by their flags of bc-web; the others have their usual names.

    If bc-web fails, that is a warning: the drive goes on, and another bc-web in this folder shows its page.
    """
    flags = [*(f"--{name}={folder}" for name, folder in folders.items()), *(["--open"] if opens else [])]
    try:
        page = subprocess.Popen(
            [sys.executable, *_PAGE, key, *flags],
            stdin=subprocess.PIPE,  # it ends when this ends
            stdout=sys.stderr,
            start_new_session=True,
        )
    except OSError as error:  # no memory, too many processes
        warn(
            f"bc-web cannot be started ({error.strerror}); start `bc-web` in this folder, and open its page Drive"
        )
        yield
        return
    try:
        yield
    finally:
        page.send_signal(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            page.wait(_END_S)
        page.kill()
        page.communicate()


def wait_until_left(log: Path) -> None:
    """Wait for Ctrl-C when a drive was ended on its page, which has buttons for what comes next."""
    if GracefulStop.current is None or not GracefulStop.current.is_requested:
        print_message(f"{log} is finished; the page stays until Ctrl-C")
        with stop_signals() as stopped:
            stopped.wait()
