"""A job's own process: it runs a command, keeps what it prints, and its exit code; whether or not bc-web goes on.

Its lock is held as long as the command runs, so that another process of the same number is not taken for it. The
command inherits the lock: where this process is killed, the job is still known to run, and can be stopped.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import FrameType
from typing import Final

from common.locks import lock

ABOUT, OUTPUT, EXIT, LOCK = "job.json", "output.txt", "exit", "lock"
"""The files of a job's folder: the request, the output, the exit code, and the lock held while it runs."""
READY: Final = b"ready\n"

_START: Final = "import sys; sys.path.append({root!r}); sys.argv[0] = {name!r}; " + (
    "from behavioural_cloning_toolkit import {function} as main; main()"
)


def python_of(name: str, root: Path) -> list[str]:
    """The start of the command line of one of the project's commands, installed or not. `-P`: a `model.py` in the
    folder where it runs is not ours."""
    return [sys.executable, "-P", "-c", _START.format(root=str(root), name=name, function=name.replace("-", "_"))]


def run_job(folder: Path, root: Path) -> None:
    """Run the command of the job in `folder`, and wait for it."""
    about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    words = about["words"]
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_SETMASK, ())  # the web server's threads block those that end a command
    signal.signal(signal.SIGINT, _leave_to_the_command)
    with (folder / LOCK).open("ab") as held, (folder / OUTPUT).open("ab") as output:
        lock(held)
        with os.fdopen(1, "wb") as asking:  # the pipe of the process that has started this one
            asking.write(READY)
        environment = {**os.environ, "COLUMNS": "160", "NO_COLOR": "1", "PYTHONUNBUFFERED": "1"}
        line = [*python_of(words[0], root), *words[1:]]
        inherited = () if sys.platform == "win32" else (held.fileno(),)
        done = subprocess.run(
            line,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            env=environment,
            pass_fds=inherited,
            check=False,
        )
        part = folder / f"{EXIT}.part"
        part.write_text(str(done.returncode), encoding="utf-8")
        part.replace(folder / EXIT)


def _leave_to_the_command(number: int, frame: FrameType | None) -> None:
    """Ctrl-C is for the command, which has the same process group; a handler, unlike SIG_IGN, is not inherited."""


def main() -> None:
    run_job(Path(sys.argv[1]), Path(sys.argv[2]))
