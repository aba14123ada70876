"""Commands that tests fork (tests/helpers/forked.py) are told of as those that are started."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.driving import PATIENCE_S, SERVER, environment

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="commands are forked so on Linux")
BEGIN = (
    "import os, signal, sys\n"
    "print(os.getcwd(), sys.argv, os.environ['COLUMNS'], sys.stdin.read(), __name__, flush=True)\n"
)


LONG = [
    ("", 0),
    ("sys.exit(3)", 3),
    ("import atexit; atexit.register(print, 'last')", 0),
    ("sys.stderr.close()", 0),
    ("os._exit(7)", 7),
    ("os.kill(os.getpid(), signal.SIGKILL)", -signal.SIGKILL),
    ("1 / 0", 1),
    ("print([int(name) for name in os.listdir('/proc/self/fd')][:3], file=sys.stderr)", 0),
    ("print([signal.getsignal(name) for name in signal.Signals])", 0),
]


@pytest.mark.parametrize(
    ("end", "code"),
    [
        ("sys.exit('why')", 1),
        ("import threading, time; threading.Thread(target=lambda: (time.sleep(0.1), print('last'))).start()", 0),
        ("raise KeyboardInterrupt", -signal.SIGINT),
        *(pytest.param(*values, marks=pytest.mark.long) for values in LONG),
    ],
)
def test_a_fork_ends_as_a_start_does(end: str, code: int, tmp_path: Path) -> None:
    variables = environment()
    line = [sys.executable, "-c", BEGIN + end, "a", "b c"]
    pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
    done = subprocess.run(
        line, cwd=tmp_path, env=variables, stdin=nothing, stdout=pipe, stderr=pipe, text=True, check=False
    )
    fork = SERVER.start(BEGIN + end, ["a", "b c"], tmp_path, variables)
    assert fork.stdout is not None
    assert fork.stderr is not None
    with fork.stdout, fork.stderr:
        stdout, stderr = fork.stdout.read(), fork.stderr.read()
    assert (fork.wait(PATIENCE_S), stdout) == (done.returncode, done.stdout)
    assert done.returncode == code
    assert stderr.splitlines()[-1:] == done.stderr.splitlines()[-1:]


def test_a_fork_is_stopped_as_a_start_is() -> None:
    # a signal just before a sleep is handled only after it
    code = "import time\nprint('begun', flush=True)\nwhile True: time.sleep(0.1)"
    fork = SERVER.start(code, [], None, environment())
    assert fork.stdout is not None
    assert fork.stderr is not None
    with fork.stdout, fork.stderr:
        assert fork.stdout.readline() == "begun\n"
        assert fork.poll() is None
        fork.send_signal(signal.SIGINT)
        assert fork.wait(PATIENCE_S) == -signal.SIGINT
        assert fork.stderr.read().endswith("KeyboardInterrupt\n")


def test_another_environment_is_not_that_of_the_forks() -> None:
    assert not SERVER.can_start(environment() | {"OMP_NUM_THREADS": "2"})
