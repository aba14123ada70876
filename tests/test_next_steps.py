"""Commands that make something end with the next step, which can be pasted."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from dataset.cli import main as bc_index
from logs import write_log
from recorder.cli import main as bc_record
from recorder.log_cli import main as bc_log
from udacity import call, make_recording, paths

STEERING = [0.1 * (row % 7 - 3) for row in range(60)]


def last_line(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().err.replace(".venv/bin/", "").splitlines()[-1]


@pytest.fixture(autouse=True)
def _project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("sessions").mkdir()
    write_log(Path("sessions/a.mcap"), STEERING)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["tag", "sessions/a.mcap", "exclude", "--rows", 1, 2], "next: `bc-index`: "),
        (["trim", "sessions/a.mcap", "--to", "b c.mcap", "--rows", 1, 9], "next: `bc-log check 'b c.mcap'`"),
        (["recover", "sessions/a.mcap", "--to", "b.mcap"], "next: `bc-log check b.mcap`"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_bc_log(arguments: list[object], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_log, *arguments) == 0
    assert last_line(capsys).startswith(expected)


def test_bc_index(capsys: pytest.CaptureFixture[str]) -> None:
    settings = ("--block-s", 0.5, "--gap-s", 0, "--labels", "as-recorded")
    assert call(bc_index, *settings) == 0
    assert last_line(capsys) == "next: `bc-train`"
    assert call(bc_index, *settings, "--index", "my index") == 0
    assert last_line(capsys) == "next: `bc-train --index 'my index'`"
    assert call(bc_index, *settings, "--validation", "a") == 3  # nothing is left to learn from
    assert "bc-train" not in last_line(capsys)


def test_an_import(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_recording(tmp_path / "drive", "".join(f"{paths(number)},0.1,0.5,0,9\n" for number in range(3)))
    shutil.rmtree("sessions")
    assert call(bc_record, "mine", "--from", tmp_path / "drive") == 0
    assert last_line(capsys) == "next: `bc-index`"
    assert call(bc_record, "mine", "--from", tmp_path / "drive", "--sessions", "here") == 0
    assert last_line(capsys) == "next: `bc-index --sessions here`"
