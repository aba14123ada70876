"""The page of a wheel: bc-web in a separate process, next to the command that drives."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from common.command import warn
from common.interrupts import is_command_stopped, stop_signals
from common.location import Location
from common.output import print_message

_PAGE: Final = ("-P", "-c", "from behavioural_cloning_toolkit import wheel_page; wheel_page()")
_END_S: Final = 2.0  # until bc-web is killed


@contextlib.contextmanager
def wheel_page(key: str, folders: Mapping[str, Location], *, opens: bool) -> Iterator[None]:
    """Serve the page of the wheel `key` while the block runs. bc-web prints the address; `opens` opens it in a
    browser. `folders` maps flags of bc-web to folders of the project; the other folders have their default names.

    If bc-web cannot be started, this prints a warning and the drive continues: another bc-web in this folder also
    shows the page.
    """
    flags = [*(f"--{name}={folder}" for name, folder in folders.items()), *(["--open"] if opens else [])]
    try:
        page = subprocess.Popen(
            [sys.executable, *_PAGE, key, *flags],
            stdin=subprocess.PIPE,  # bc-web ends when this process ends, which closes the pipe
            stdout=sys.stderr,
            start_new_session=True,
        )
    except OSError as error:  # no memory, too many processes
        warn(f"bc-web cannot be started ({error.strerror}); run `bc-web` in this folder, and open its page Drive")
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
    """After a drive was ended on its page, wait for Ctrl-C: the page has buttons for the next steps."""
    if not is_command_stopped():
        print_message(f"{log} is finished; the page stays until Ctrl-C")
        with stop_signals() as stopped:
            stopped.wait()
