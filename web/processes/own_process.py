"""Processes next to the server: each runs a module, and reports lines of JSON."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import behavioural_cloning_toolkit
from common import UserError
from common.errors import printable
from common.output import print_result
from common.process_settings import end_with_parent

_ROOT: Final = str(Path(behavioural_cloning_toolkit.__file__).parent)


def start_process(module: str, words: list[str], temporary: str) -> subprocess.Popen[bytes]:
    """Start a process that calls `main()` of a module with these words as arguments. Its temporary files are in
    the folder `temporary`, because a killed process leaves them behind. Raises OSError if it does not start."""
    start = f"import sys; sys.path.append(sys.argv.pop(1)); from {module} import main; main()"
    return subprocess.Popen(
        [sys.executable, "-P", "-c", start, _ROOT, *words],
        stdin=subprocess.PIPE,  # it ends with this process
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "TMPDIR": temporary},
        start_new_session=True,
    )


def reports(process: subprocess.Popen[bytes]) -> Iterator[dict[str, Any]]:
    """The reports of a process, until it ends."""
    assert process.stdout is not None  # noqa: S101
    with process.stdout as lines:
        for line in lines:
            with contextlib.suppress(ValueError):
                yield json.loads(line)


def report(**values: object) -> None:
    """Report progress or a `problem` from the process to the server."""
    print_result(json.dumps(values))


def counter(step: int = 1, **more: object) -> Callable[[], None]:
    """A function that reports `step` pictures more at each call."""
    counts = itertools.count(step, step)
    return lambda: report(pictures=next(counts), **more)


def run_in_process(work: Callable[..., object], niceness: int = 0) -> None:
    """Call `work` with this process's arguments, and report its errors."""
    if sys.platform != "win32":
        os.nice(niceness)
    end_with_parent()
    try:
        work(*sys.argv[1:])
    except UserError as error:
        report(problem=printable(str(error)))
    except OSError as error:
        report(problem=printable(f"{error.filename or sys.argv[1]}: {error.strerror}"))
    except MemoryError:
        report(problem="not enough memory")
