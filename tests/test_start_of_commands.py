"""How a command begins: what it loads, Ctrl-C, errors and exit codes."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import behavioural_cloning_toolkit
from common.interrupts import STOP_SIGNALS
from tests.helpers.driving import COMMANDS, PATIENCE_S, environment, run_code
from tests.helpers.logs import write_log
from tests.helpers.repository import ROOT
from tests.helpers.udacity import call
from tests.test_rooms import MAY_IMPORT

# Each import of a command's is followed by a signal, at the point that is counted up to on the command line.
INTERRUPTED_IMPORT = """
import builtins, os, signal, sys
import behavioural_cloning_toolkit
from common.interrupts import STOP_SIGNALS
name, at = sys.argv.pop(1), int(sys.argv.pop(1))
wanted, begun = [at], builtins.__import__
def importing(*given, **named):
    wanted[0] -= 1
    if wanted[0] == 0:
        os.kill(os.getpid(), signal.SIGINT)
    return begun(*given, **named)
command = getattr(behavioural_cloning_toolkit, name)
builtins.__import__ = importing
command()
"""


@pytest.mark.parametrize(("name", "at"), [("bc-log", 1), ("bc-log", 300), ("bc-drive", 30)])
def test_ctrl_c_while_a_command_is_loaded_is_one_line(name: str, at: int) -> None:
    line = [sys.executable, "-c", INTERRUPTED_IMPORT, name.replace("-", "_"), str(at), "--help"]
    done = subprocess.run(line, env=environment(), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", f"{name}: stopped\n")


INTERRUPTED_NUMPY = """
import os, signal, sys
import behavioural_cloning_toolkit
from common.interrupts import STOP_SIGNALS

class Interrupting:
    def find_spec(self, name, *_):
        if name == "numpy.matrixlib":
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupting())
getattr(behavioural_cloning_toolkit, sys.argv.pop(1))()
"""


@pytest.mark.parametrize(
    ("name", "flags"),
    [
        ("bc_train", ["--epochs", "1"]),
        ("bc_train", ["export", "first", "--onnx"]),
        ("bc_play", ["a.mcap", "--run", "first", "--save", "a.rrd"]),
        ("bc_eval", ["first"]),
        ("bc_drive", ["first"]),
    ],
)
def test_ctrl_c_while_numpy_is_loaded_is_not_lost(name: str, flags: list[str], tmp_path: Path) -> None:
    """PyTorch's own code drops what is raised while it imports NumPy: the command would go on without NumPy."""
    write_log(tmp_path / "a.mcap", [0.1, 0.2])
    line = [sys.executable, "-c", INTERRUPTED_NUMPY, name, *flags]
    done = subprocess.run(line, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False)
    prog = " ".join([name.replace("_", "-"), *(flags[:1] if flags[0] == "export" else [])])
    assert (done.returncode, done.stdout, done.stderr) == (130, "", f"{prog}: stopped\n")


def test_a_command_under_nohup_does_not_hear_a_terminal_that_is_closed() -> None:
    code = (
        "import behavioural_cloning_toolkit, os, signal, sys\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "sys.argv[1:] = ['--help']\n"
        "sys.meta_path.insert(0, type('', (), {'find_spec': lambda *_: os.kill(os.getpid(), signal.SIGHUP)}))\n"
        "behavioural_cloning_toolkit.bc_log()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


HEAVY = [
    "numpy",
    "pyarrow",
    "cv2",
    "google.protobuf",
    "mcap",
    "torch",
    "rerun",
    "socketio",
    "starlette",
]
LOADED_BY = """
import sys, behavioural_cloning_toolkit
sys.argv = {line}
try:
    getattr(behavioural_cloning_toolkit, sys.argv[0].replace("-", "_"))()
finally:
    print([name for name in {heavy} if name in sys.modules], file=sys.stderr)
"""


def loaded_by(*line: str) -> str:
    """The last line of a command's errors: which of the heavy modules it has loaded."""
    done = run_code(LOADED_BY.format(line=list(line), heavy=HEAVY))
    assert done.returncode == 0, done.stderr
    return done.stderr.splitlines()[-1]


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_loads_nothing_heavy(name: str) -> None:
    assert loaded_by(name, "--help") == "[]"


def test_a_log_is_described_without_arrow_and_opencv(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.mcap", [0.1, 0.2])
    assert loaded_by("bc-log", "info", str(log)) == "['numpy', 'mcap']"


def test_every_command_prints_its_version(capsys: pytest.CaptureFixture[str]) -> None:
    mains = re.findall(
        r'_command\("(bc-[\w-]+)", "([\w.]+)"\)', (ROOT / "behavioural_cloning_toolkit.py").read_text()
    )
    assert {name for name, _ in mains} == set(COMMANDS)
    for name, module in mains:
        assert call(import_module(module).main, "--version") == 0
        assert capsys.readouterr().out == f"{name} {behavioural_cloning_toolkit.__version__}\n"


def test_the_version_stands_in_one_place_and_in_the_changelog() -> None:
    file = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" not in file["project"]
    module, _, name = file["tool"]["setuptools"]["dynamic"]["version"]["attr"].rpartition(".")
    version = getattr(import_module(module), name)
    assert behavioural_cloning_toolkit.__version__ == version
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^## {re.escape(version)} \(\d{{4}}-\d\d-\d\d\)$", changes, re.MULTILINE)


def test_every_room_is_typed() -> None:
    package_data = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    assert package_data["package-data"]["*"] == ["py.typed"]
    assert all((ROOT / room / "py.typed").is_file() for room in MAY_IMPORT)


def test_commands_do_not_mind_what_lies_in_the_working_folder(tmp_path: Path) -> None:
    for room in MAY_IMPORT:
        (tmp_path / f"{room}.py").write_text("raise SystemExit('the wrong one')\n")
    # as the installed script does, whose own folder is first on the path
    script = tmp_path / "bin" / "bc-log"
    script.parent.mkdir()
    script.write_text("from behavioural_cloning_toolkit import bc_log\nbc_log()\n")
    done = subprocess.run(
        [sys.executable, str(script), "--help"], cwd=tmp_path, env=environment(), capture_output=True, check=False
    )
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("error", "reported"),
    [
        ("MemoryError()", "not enough memory; close"),
        ("MemoryError('malloc of 5 GB failed')", "not enough memory (malloc of 5 GB failed); close"),
        ("RuntimeError('DefaultCPUAllocator: can\\'t allocate memory: 9 bytes')", "not enough memory (Default"),
        ("RuntimeError('CUDA out of memory. Tried')", "not enough memory (CUDA out of memory. Tried); close"),
    ],
)
def test_no_memory_is_one_line(error: str, reported: str) -> None:
    done = run_action(f"raise {error}")
    assert done.returncode == 1
    [line] = done.stderr.splitlines()
    assert line.startswith(f"bc-test: {reported}")


def test_bad_usage_has_an_exit_code_of_its_own() -> None:
    usage, other = (
        run_action(f"from common.errors import UsageError, UserError; raise {kind}('--a and --b: give one')")
        for kind in ("UsageError", "UserError")
    )
    assert (usage.returncode, other.returncode) == (2, 1)
    assert usage.stderr == other.stderr == "bc-test: --a and --b: give one\n"


def test_a_bug_keeps_its_traceback() -> None:
    done = run_action("raise ZeroDivisionError('a bug')")
    assert done.returncode == 1
    assert done.stderr.startswith("Traceback")
    assert done.stderr.endswith("ZeroDivisionError: a bug\n")


def run_action(body: str) -> subprocess.CompletedProcess[str]:
    return run_code(ACTION.format(body=body))


ACTION = """
import os, signal, sys, time
from dataclasses import dataclass
from common.command import run_command

@dataclass
class Nothing:
    pass

def act(config):
    {body}
    return 0

run_command("bc-test", Nothing, act)
"""


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_a_signal_ends_a_command_with_one_line(number: signal.Signals) -> None:
    done = run_action(f"os.kill(os.getpid(), {number:d}); time.sleep({PATIENCE_S})")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "bc-test: stopped\n")


def test_a_second_ctrl_c_ends_what_tidies_up() -> None:
    stop = "os.kill(os.getpid(), signal.SIGINT)"
    done = run_action(f"""
    try:
        {stop}
        time.sleep({PATIENCE_S})
    finally:
        {stop}
        time.sleep({PATIENCE_S})""")
    assert (done.returncode, done.stderr) == (130, "bc-test: stopped\n")
