"""How a command begins: Ctrl-C is heard from the first moment, and what is in the way of the rooms is named."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import behavioural_cloning_toolkit
from tests.helpers.driving import COMMANDS, PATIENCE_S, command, environment, run_code
from tests.helpers.logs import write_log
from tests.helpers.repository import ROOT
from tests.helpers.udacity import call
from tests.test_rooms import MAY_IMPORT

HIDING = {"a module": "{room}.py", "a package": "{room}/__init__.py", "a folder": "{room}/notes.txt"}

# Each import of a command's is followed by a signal, at the point that is counted up to on the command line.
INTERRUPTED_IMPORT = """
import builtins, os, signal, sys
import behavioural_cloning_toolkit
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


@pytest.mark.parametrize("kind", HIDING)
def test_what_is_in_the_way_of_a_rooms_name_is_named(kind: str, tmp_path: Path) -> None:
    """A script of a student's, and beside it something that is called as a room is."""
    hiding = tmp_path / HIDING[kind].format(room="common")
    hiding.parent.mkdir(exist_ok=True)
    hiding.touch()
    script = tmp_path / "mine.py"
    script.write_text("from recorder import Log\n")
    variables = environment()
    if kind == "a folder":  # without an __init__.py it only hides what comes after all folders of the path
        variables.pop("PYTHONPATH")
        if subprocess.run([sys.executable, "-c", "import common"], cwd="/", env=variables, check=False).returncode:
            pytest.skip("the toolkit is not installed")
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env=variables, capture_output=True, text=True, check=False
    )
    if done.returncode == 0:
        assert kind == "a folder"  # of an installation that is no link to the sources
        return
    last = done.stderr.splitlines()[-1]
    assert last.startswith("ImportError: ")
    assert str(hiding if kind != "a folder" else hiding.parent) in last
    assert "is in the way: Python takes it for this toolkit's `common`; rename it" in last


def test_a_module_that_a_room_does_not_need_is_in_nobodys_way(tmp_path: Path) -> None:
    (tmp_path / "model.py").write_text("mine = True\n")
    (tmp_path / "mine.py").write_text("from recorder import Log\nfrom model import mine\n")
    done = subprocess.run([sys.executable, str(tmp_path / "mine.py")], env=environment(), check=False)
    assert done.returncode == 0


def record_installed(folder: Path, package: str, file: str) -> None:
    """Write down, as pip does, that a package has installed this file into the folder."""
    record = folder / f"{package}-1.0.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (record / "RECORD").write_text(f"{file},,\n{record.name}/METADATA,,\n")


def test_a_package_that_owns_a_rooms_name_is_named(tmp_path: Path) -> None:
    (tmp_path / "common").mkdir()
    (tmp_path / "common" / "__init__.py").touch()
    record_installed(tmp_path, "othertool", "common/__init__.py")
    variables = environment()
    variables["PYTHONPATH"] = os.pathsep.join([str(tmp_path), variables["PYTHONPATH"]])
    done = subprocess.run(
        command("bc-log", "--help"), cwd="/", env=variables, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stderr == (
        "bc-log: `common` is also a name of another installed package (othertool), which hides this toolkit's:"
        " `pip uninstall othertool`, or install the toolkit into an environment of its own\n"
    )


@pytest.mark.parametrize("is_uninstalled", [False, True])
def test_a_package_that_has_written_over_a_room_is_named(is_uninstalled: bool, tmp_path: Path) -> None:
    """As `dataset` of the package index does, where both are installed."""
    shutil.copy(ROOT / "behavioural_cloning_toolkit.py", tmp_path)
    (tmp_path / "dataset").mkdir()
    (tmp_path / "dataset" / "config.py").touch()
    if not is_uninstalled:
        (tmp_path / "dataset" / "__init__.py").write_text("from dataset.database import Database\n")
        record_installed(tmp_path, "dataset", "dataset/__init__.py")
    variables = {**environment(), "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        command("bc-index", "--help"), cwd="/", env=variables, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (1, "")
    if is_uninstalled:
        why = "this toolkit's `dataset` was overwritten by another package of that name: install the toolkit again"
    else:
        why = (
            "another installed package (dataset) has written its `dataset` over this toolkit's: `pip uninstall"
            " dataset` and install the toolkit again, or install it into an environment of its own"
        )
    assert done.stderr == f"bc-index: {why}\n"


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


def test_every_room_looks_whether_those_under_it_are_ours() -> None:
    for room, under in MAY_IMPORT.items():
        if under:
            assert "refuse_hidden(__name__)" in (ROOT / room / "__init__.py").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("error", "told"),
    [
        ("MemoryError()", "not enough memory; close"),
        ("MemoryError('malloc of 5 GB failed')", "not enough memory (malloc of 5 GB failed); close"),
        ("RuntimeError('DefaultCPUAllocator: can\\'t allocate memory: 9 bytes')", "not enough memory (Default"),
        ("RuntimeError('CUDA out of memory. Tried')", "not enough memory (CUDA out of memory. Tried); close"),
    ],
)
def test_no_memory_is_one_line(error: str, told: str) -> None:
    done = run_action(f"raise {error}")
    assert done.returncode == 1
    [line] = done.stderr.splitlines()
    assert line.startswith(f"bc-test: {told}")


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
import os, signal, sys, time, weakref
from dataclasses import dataclass
from pathlib import Path
from common.command import run_command
from common.files import atomic_file
from common.interrupts import stop_signals, uninterrupted

@dataclass
class Nothing:
    pass

def sleep():
    while True:  # a signal that comes just before a long sleep would be heard after it
        time.sleep(0.01)

def noted(stopped):
    while not stopped.wait(0.01):
        pass

def begun():
    print("begun", file=sys.stderr)

def interrupted_in_a_callback():
    thing = Nothing()
    reference = weakref.ref(thing, lambda _: os.kill(os.getpid(), signal.SIGINT) or sleep())
    del thing

def slow(work):
    try:
        begun()
        sleep()
    finally:
        begun()
        work()

def act(config):
    {body}
    return 0

run_command("bc-test", Nothing, act)
"""
WAYS = {
    "tidying up": "slow(lambda: sleep())",
    "uninterrupted": "slow(lambda: uninterrupted().__enter__() or sleep())",
    "a stop that is noted": ("with stop_signals() as stopped:\n        begun(); noted(stopped); begun(); sleep()"),
    "a file half written": (
        "with atomic_file(Path('whole'), overwrite=False) as part:\n"
        "        part.write_bytes(b'half'); slow(lambda: sleep())"
    ),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_second_ctrl_c_ends_at_once_and_says_so(way: str, tmp_path: Path) -> None:
    line = [sys.executable, "-c", ACTION.format(body=WAYS[way])]
    with subprocess.Popen(line, cwd=tmp_path, env=environment(), stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        try:
            assert process.stderr.readline() == "begun\n"
            process.send_signal(signal.SIGINT)
            assert process.stderr.readline() == "begun\n"
            process.send_signal(signal.SIGTERM)  # which comes twice by itself, and does not count
            assert process.stderr.readline() == "bc-test: stopping; Ctrl-C again ends at once\n"
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE_S) == 130
        finally:
            process.kill()
        assert process.stderr.read() == "bc-test: ended at once; unfinished files have names that end in .part\n"
    assert all(path.suffix == ".part" for path in tmp_path.iterdir())


def test_a_ctrl_c_that_comes_while_python_tidies_up_is_not_lost() -> None:
    """What is raised in a callback of a weak reference goes no further, and the command would wait for ever."""
    done = run_action("interrupted_in_a_callback(); sleep()")
    assert (done.returncode, done.stderr) == (130, "bc-test: stopped\n")
