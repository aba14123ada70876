"""What commands print passes one place: foreign control characters are escaped there, and commands spelled."""

from __future__ import annotations

import ast
import os
import pty
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from rich.table import Table
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from common.output import ask, print_message, print_result, print_table, shell_command
from drive.cli import main as bc_drive
from drive.evaluation.eval_cli import main as bc_eval
from model.cli import main as bc_train
from tests.helpers.driving import command, environment
from tests.helpers.logs import write_log
from tests.helpers.repository import ROOT
from tests.helpers.toy import road, toy_index
from tests.helpers.udacity import call
from tests.test_rooms import MAY_IMPORT
from viz.cli import main as bc_play

EVIL = "a\x1b]0;owned\x07\x1b[2J\x9b31m\nbc-log: all is well\r\u202eb"
CONTROL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u202e]")
PRINTING = {"print", "Console", "sys.stdout", "sys.stderr", "sys.__stdout__", "sys.__stderr__", "os.write"}


def printed_by_itself(tree: ast.Module) -> list[str]:
    """Where a module prints, or gets hold of what prints."""
    lines = []
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Call):
            names = [ast.unparse(node.func)]
        elif isinstance(node, ast.Attribute):
            names = [ast.unparse(node)]
        elif isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names]
        lines += [f"line {getattr(node, 'lineno', 0)}: {name}" for name in names if name in PRINTING]
    return lines


@pytest.mark.parametrize("keys", [b"\x04", b"\n", b"n\n"])
def test_the_end_of_input_answers_a_question_with_no(keys: bytes) -> None:
    ends = pty.openpty()
    code = "from common.output import ask; print(ask('Tag it?'))"
    os.write(ends[0], keys)
    asked = subprocess.run(
        [sys.executable, "-c", code], stdin=ends[1], stderr=ends[1], stdout=subprocess.PIPE, cwd=ROOT, check=False
    )
    for end in ends:
        os.close(end)
    assert (asked.returncode, asked.stdout) == (0, b"False\n")


def test_nobody_is_asked_if_the_input_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    assert ask("Tag it?") is None


@pytest.mark.parametrize("room", sorted(MAY_IMPORT.keys() - {"common"}))
def test_no_room_prints_by_itself(room: str) -> None:
    """Results go through `common.output.print_result` and `print_table`, all else through `print_message`."""
    for path in (ROOT / room).rglob("*.py"):
        assert printed_by_itself(ast.parse(path.read_text(encoding="utf-8"))) == [], path


def test_nothing_in_a_line_moves_the_cursor_or_begins_another(capsys: pytest.CaptureFixture[str]) -> None:
    print_result(EVIL, "a second line")
    print_message(EVIL)
    print_message(EVIL, heading="bc-log:", style="red")
    table = Table(EVIL, box=None)
    table.add_row(f"[red]{EVIL}[/]")
    print_table(table, f"[bold]{EVIL}[/]")
    out, err = capsys.readouterr()
    assert not CONTROL.search(out)
    assert not CONTROL.search(err)
    assert out.splitlines()[0].count("bc-log: all is well") == 1
    assert out.splitlines()[1] == "a second line"
    assert len(err.splitlines()) == 2


@pytest.mark.parametrize("columns", [None, "24"])
def test_no_cell_of_a_table_is_cut(
    columns: str | None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", columns)
    table = Table(box=None)
    table.add_column("session")
    table.add_column("rows", no_wrap=True)
    table.add_row("lake" * 30, "123456 to 123789")
    print_table(table, "one line " * 20)
    out = capsys.readouterr().out
    assert "123456 to 123789" in out
    assert sum(out.count(letter) for letter in "lak") == 90 + 20  # one "l" a line of the text
    if columns is None:
        assert len(out.splitlines()) == 3


def evil_commands(log: Path, index: Path) -> dict[str, list[str]]:
    """Commands that have something to say of foreign names, and end well."""
    other = log.with_name(f"{EVIL}2.mcap")
    return {
        "check": command("bc-log", "check", log),
        "info": command("bc-log", "info", log),
        "trim": command("bc-log", "trim", log, "--to", other, "--start", "0"),
        "recover": command("bc-log", "recover", log, "--to", other),
        "merge": command("bc-log", "merge", log, log, "--to", other),
        "index": command("bc-index", log, "--index", index),
        "save": command("bc-play", log, "--save", log.with_suffix(".rrd")),
        "missing": command("bc-log", "info", log.with_name(f"{EVIL}3.mcap")),
        "usage": command("bc-log", "info", f"--{EVIL}"),
    }


@pytest.mark.parametrize("name", evil_commands(Path("log"), Path("index")))
def test_no_name_reaches_the_terminal_as_a_control_character(name: str, tmp_path: Path) -> None:
    log = write_log(tmp_path / f"{EVIL}.mcap", [0.1] * 20, road, cameras=["center"])
    printed = on_terminal(evil_commands(log, tmp_path / "index")[name], tmp_path)
    beyond_colours = re.sub(r"\x1b\[[0-9;]*m|\r\n", "\n", printed)
    # what draws bars: lines erased, cursor up, hidden and shown
    assert not CONTROL.search(re.sub(r"\x1b\[(2K|1A|\?25[lh])|\r", "", beyond_colours)), ascii(printed)
    assert "owned" in printed  # it has been named


def on_terminal(line: list[str], cwd: Path, stdout: int | None = None) -> str:
    """What a command shows on a terminal of its own."""
    shown, terminal = pty.openpty()
    colours = {**environment(), "TERM": "xterm"}
    colours.pop("NO_COLOR")
    process = subprocess.Popen(line, cwd=cwd, env=colours, stdout=stdout or terminal, stderr=terminal)
    os.close(terminal)
    printed = b""
    try:
        while data := os.read(shown, 65536):
            printed += data
    except OSError:  # so ends a terminal on Linux
        pass
    os.close(shown)
    process.wait()
    return printed.decode()


def test_a_message_stands_above_the_status(tmp_path: Path) -> None:
    """Whoever prints it: the status line is erased before, and drawn anew below."""
    code = (
        "from common.output import print_message; from common.progress import StatusLine, track\n"
        "with StatusLine() as line:\n"
        "    line.show('the live line')\n"
        "    print_message('MESSAGE')\n"
        "for item in track([1], 'the live line', 1):\n"
        "    print_message('MESSAGE')\n"
    )
    shown = on_terminal([sys.executable, "-c", code], tmp_path)
    lines = [re.sub(r"^.*\x1b\[2K", "", line) for line in shown.replace("\r\n", "\n").split("\n")]
    assert sum(re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]|\r", "", line) == "MESSAGE" for line in lines) == 2, ascii(shown)


def test_a_command_has_its_path_where_the_shell_does_not_find_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scripts = tmp_path / "a place" / "bin"
    scripts.mkdir(parents=True)
    for name in ("bc-play", "bc-runs"):
        (scripts / name).write_text("#!/bin/sh\n")
        (scripts / name).chmod(0o755)
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(scripts))
    monkeypatch.setenv("PATH", "/nowhere")
    far = tmp_path.joinpath(*"abcdefghijklmnopqrst")  # from here, no other path to it is shorter
    far.mkdir(parents=True)
    monkeypatch.chdir(far)
    assert shlex.split(shell_command("bc-play")) == [str(scripts / "bc-play")]
    monkeypatch.chdir(tmp_path)
    print_result("look at it with `bc-play run.mcap`; `bc-playful` is none, and bc-play is a name")
    assert capsys.readouterr().out == (
        "look at it with `'a place/bin/bc-play' run.mcap`; `bc-playful` is none, and bc-play is a name\n"
    )
    print_result("`bc-runs --help` shows one")
    assert capsys.readouterr().out == "`'a place/bin/bc-runs' --help` shows one\n"
    monkeypatch.setenv("PATH", str(scripts))
    assert shell_command("bc-play") == "bc-play"
    assert shell_command("rerun") == "rerun"  # of a toolkit that is not installed


def test_a_character_that_the_encoding_lacks_is_escaped() -> None:
    code = (
        "from common.streams import command_streams\n"
        "with command_streams():\n"
        "    print('\\udcff, and a tab:\\t.')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(), capture_output=True, check=False, text=True
    )
    assert done.stdout == "\\udcff, and a tab:\t.\n"


BESIDE_A_BAR = """
import logging
from dataclasses import dataclass
from common.command import run_command
from common.output import print_message, print_result
from common.progress import StatusLine, progress_bar

@dataclass
class Nothing:
    pass

def act(config):
    with progress_bar() as bar:
        bar.update(bar.add_task("training", total=10, note=""), advance=1)
        print_message("said")
        print_result("a result")
        logging.getLogger("model").warning("logged: %s", {evil!r} * 5)
        bar.refresh()
    with StatusLine() as status:
        status.show("driving")
        logging.getLogger("model").warning("logged again")
        print_message("said again")
    return 0

run_command("bc-test", Nothing, act)
"""


def test_what_is_said_and_logged_beside_a_bar_is_a_line_above_it(tmp_path: Path) -> None:
    """And results get into the file that they are sent to: a bar takes over what is printed."""
    with (tmp_path / "results").open("wb") as file:
        code = BESIDE_A_BAR.format(evil=EVIL)
        shown = on_terminal([sys.executable, "-c", code], tmp_path, stdout=file.fileno())
    assert (tmp_path / "results").read_text() == "a result\n"
    assert "a result" not in shown
    drawing = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
    lines = [re.split(r"\r", drawing.sub("", line))[-1] for line in shown.split("\r\n")]
    assert "said" in lines
    assert "logged again" in lines
    assert "said again" in lines
    (logged,) = (line for line in lines if line.startswith("logged: "))
    assert logged.count("owned") == 5
    assert not CONTROL.search(drawing.sub("", shown).replace("\r", "").replace("\n", ""))


def test_trainings_log_lines_are_messages_in_commands_that_load_a_run(
    trained: Path, cwd: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run of an earlier version, whose name nobody would give."""
    index = toy_index(cwd)
    run = cwd / "runs" / "a\x1b[2Jb\nc"
    shutil.copytree(trained, run)
    weights = run / "model.safetensors"
    with safe_open(weights, framework="np") as file:
        stored = {name: value for name, value in file.metadata().items() if name != "sha256"}
    save_file(load_file(weights), weights, stored)
    settings = ("--network", "small", "--epochs", 1, "--batch", 8, "--threads", 1)
    flags = ("--index", index, "--runs", cwd / "runs", *settings)
    commands: list[tuple[Callable[[], None], tuple[object, ...]]] = [
        (bc_eval, ("RUN", "--index", index)),
        (bc_play, (cwd / "toy.mcap", "--run", "RUN", "--write", cwd / "said.mcap")),
        (bc_train, ("continue", "RUN", "--name", "next", *flags)),
        (bc_drive, ("RUN", "--log", cwd / "drive.mcap", "--port", 0, "--viewer", "nowhere")),
    ]
    threads = torch.get_num_threads()
    for number, (main, line) in enumerate(commands):
        run = run.rename(f"{run}{number}")  # of each, it is said once in a process
        call(main, *(run if word == "RUN" else word for word in line))
        printed = capsys.readouterr().err
        notice = f"{cwd}/runs/{run.name}: of an earlier version, without checksums: "
        notice = notice.replace("\x1b", "\\x1b").replace("\n", "\\n")
        assert [line.startswith(notice) for line in printed.splitlines()].count(True) == 1, printed
        assert not CONTROL.search(printed)
    torch.set_num_threads(threads)
