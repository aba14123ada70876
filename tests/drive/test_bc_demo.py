"""The demo refuses at once what would fail later, and what it prints can be typed."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

from drive.demo import main as bc_demo
from tests.helpers.driving import COMMANDS, Process, command, environment, one_line_in
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until


@pytest.mark.parametrize("flag", ["--epochs=-1", "--laps=nan", "--share=0"])
def test_what_would_fail_after_minutes_is_refused_before_the_first_step(
    flag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(bc_demo, "--folder", "demo", flag) == 2
    assert one_line_in(capsys).startswith(f"bc-demo: {flag.partition('=')[0]} ")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """An environment that no shell has activated, whose commands only say that they were called; its Python."""
    folder = tmp_path / "a venv"
    venv.create(folder, symlinks=True)
    programs = folder / Path(sysconfig.get_path("scripts")).name
    packages = next(folder.rglob("site-packages"))
    (packages / "others.pth").write_text(sysconfig.get_path("purelib"))  # all that is installed here
    for name in COMMANDS:
        (programs / name).write_text("#!/bin/sh\necho called in $(pwd): $0 $@\n")
        (programs / name).chmod(0o755)
    return programs / "python"


@pytest.mark.skipif(sys.platform == "win32", reason="a shell of Unix")
def test_the_commands_that_it_ends_with_can_be_typed(installed: Path, tmp_path: Path) -> None:
    variables = environment() | {"PATH": os.defpath}
    code = "from behavioural_cloning_toolkit import bc_demo; bc_demo()"
    line = [str(installed), "-c", code, "--folder", "my demo"]
    done = subprocess.run(line, cwd=tmp_path, env=variables, capture_output=True, text=True, check=True)
    printed = done.stdout.splitlines()
    steps = [number for number, text in enumerate(printed) if text.startswith("$ bc-")]
    assert len(steps) == 6
    for number, step in enumerate(steps):  # each is printed before its command prints
        assert printed[step + 1].startswith(f"called in {tmp_path / 'my demo'}: ")
        assert printed[step - 1] == f"{number + 1} of 6"
        assert printed[step + 2].startswith("took ")
    assert shlex.split(printed[-3])[1] == "my demo/drives/demo-mountain-15mph.mcap"
    assert "drive yourself" in printed[-2]
    for closing, program, last in ((printed[-3], "bc-play", "15mph.mcap"), (printed[-1], "bc-web", "--open")):
        typed = subprocess.run(
            closing, cwd=tmp_path, env=variables, shell=True, capture_output=True, text=True, check=True
        )
        assert typed.stdout.startswith(f"called in {tmp_path}: ")
        assert f"/{program} " in typed.stdout
        assert typed.stdout.endswith(f"{last}\n")
    [activate] = [text.partition(": ")[2] for text in printed if "source " in text]
    play = shlex.split(activate)[1]
    assert Path(play).exists()


def test_one_that_is_stopped_at_once_leaves_no_folder(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    with Process(command("bc-demo", "--folder", folder)) as process:
        wait_until(lambda: any(folder.glob("sessions/*.part")))
        assert process.end() == 130
    assert not folder.exists()


def test_without_a_terminal_a_line_now_and_then_shows_progress(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    import time

    from common import progress

    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.01)
    printed = ""
    for number in progress.track(range(4), "reading", 4):
        while number == 1 and "reading: 25 %" not in printed:
            time.sleep(0.01)
            printed += capfd.readouterr().err
    assert progress.duration_text(40) == "40 s"
    assert progress.duration_text(725) == "12 min"
    assert progress.duration_text(3 * 3600 + 300) == "3 h 5 min"
