"""Commands that make something end with the next step, which can be pasted."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from dataset.cli import main as bc_index
from recorder.import_cli import main as bc_import
from recorder.log_cli import main as bc_log
from tests.helpers.logs import write_log
from tests.helpers.udacity import call, jpeg, make_recording, paths

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
        (["ls"], "next: `bc-index`"),
        (["info", "a"], "next: `bc-index`"),
        (["check", "a", "--no-look"], "next: `bc-index`"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_bc_log(arguments: list[object], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_log, *arguments) == 0
    assert last_line(capsys).startswith(expected)


def test_what_is_odd_is_excluded_first_and_then_looked_at(capsys: pytest.CaptureFixture[str]) -> None:
    write_log(Path("sessions/b c.mcap"), [3.0] * 30 + STEERING[:30])
    exclude = "next: `bc-log tag 'sessions/b c.mcap' exclude --odd`: "
    assert call(bc_log, "ls") == 0
    assert last_line(capsys).startswith("next: `bc-log info 'sessions/b c.mcap'`: ")
    for arguments in (["info", "a", "b c"], ["check", "--no-look", "a", "b c"]):
        call(bc_log, *arguments)
        assert last_line(capsys).startswith(exclude)
    assert call(bc_log, "tag", "b c", "exclude", "--odd") == 0
    capsys.readouterr()
    for arguments in (["ls"], ["info", "b c"], ["check", "--no-look", "b c"]):
        assert call(bc_log, *arguments) == 0  # no finding is left
        printed = capsys.readouterr()
        assert printed.err.replace(".venv/bin/", "").splitlines()[-1] == "next: `bc-index`"
        assert "--odd" not in printed.out
        assert ("1 odd stretch is excluded" in printed.out) == (arguments != ["ls"])
    for command in ("ls", "info", "check"):
        call(bc_log, command, "sessions/a.mcap", "--json")
        assert capsys.readouterr().err == ""


def test_a_dataset(capsys: pytest.CaptureFixture[str]) -> None:
    write_log(Path("sessions/a.mcap"), STEERING[:3], lambda camera, row: jpeg(row), overwrite=True)
    assert call(bc_log, "export", "a", "--lerobot", "my data") == 0
    assert last_line(capsys).startswith("next: `hf upload 'my data' 'my data' --repo-type dataset`: ")


def test_a_drive_is_looked_at(capsys: pytest.CaptureFixture[str]) -> None:
    Path("drives").mkdir()
    write_log(Path("drives/first.mcap"), STEERING)
    assert call(bc_log, "info", "first") == 0
    assert last_line(capsys) == "next: `bc-play drives/first.mcap`"


def test_a_damaged_log_is_recovered_first(capsys: pytest.CaptureFixture[str]) -> None:
    data = bytearray(Path("sessions/a.mcap").read_bytes())
    data[len(data) // 2] ^= 1
    Path("sessions/a.mcap").write_bytes(data)
    assert call(bc_log, "check", "a") == 3
    assert last_line(capsys).startswith("next: `bc-log recover sessions/a.mcap`: ")


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
    assert call(bc_import, tmp_path / "drive", "mine") == 0
    assert last_line(capsys) == "next: `bc-index`"
    assert call(bc_import, tmp_path / "drive", "mine", "--sessions", "here") == 0
    assert last_line(capsys) == "next: `bc-index --sessions here`"
