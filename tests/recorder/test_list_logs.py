"""`bc-log ls` lists sessions and drives, one line each."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from common.car import Camera
from logs import START_NS, write_log
from recorder.log_cli import main
from udacity import call, jpeg

DAY_NS = 24 * 3600 * 10**9


def picture(camera: Camera, row: int) -> bytes:
    return jpeg(60 + row, 10 * row + len(camera))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    return tmp_path


def log_of(path: Path, rows: int, start_ns: int = START_NS) -> Path:
    path.parent.mkdir(exist_ok=True)
    return write_log(path, [0.1] * rows, picture, start_ns=start_ns)


def names(capsys: pytest.CaptureFixture[str], *arguments: object) -> list[str]:
    capsys.readouterr()
    assert call(main, "ls", *arguments) == 0
    return [line.split()[0] for line in capsys.readouterr().out.splitlines()[1:]]


def test_sessions_and_drives_are_listed_the_newest_first(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log_of(here / "sessions" / "monday.mcap", 3)
    log_of(here / "sessions" / "tuesday.mcap", 5, START_NS + DAY_NS)
    log_of(here / "drives" / "wednesday.mcap", 4, START_NS + 2 * DAY_NS)
    assert names(capsys) == ["wednesday", "tuesday", "monday"]
    assert names(capsys, "--sort", "name") == ["wednesday", "monday", "tuesday"]  # drives/ before sessions/
    assert names(capsys, "--sort", "rows") == ["tuesday", "wednesday", "monday"]
    assert names(capsys, "sessions", "--sort", "rows") == ["tuesday", "monday"]


def test_a_line_tells_of_its_log(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = log_of(here / "sessions" / "monday.mcap", 30)
    assert call(main, "tag", log, "exclude", "--rows", 2, 4) == 0
    capsys.readouterr()
    assert call(main, "ls") == 0
    line = capsys.readouterr().out.splitlines()[1].split()
    assert (line[0], line[4], line[-1]) == ("monday", "30", "exclude")
    assert call(main, "ls", "--json") == 0
    told = capsys.readouterr().out
    assert call(main, "info", "sessions/monday.mcap", "--json") == 0
    assert json.loads(told) == json.loads(capsys.readouterr().out)


def test_unfinished_and_broken_logs_are_shown_as_such(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log_of(here / "sessions" / "monday.mcap", 3)
    whole = log_of(here / "elsewhere" / "killed.mcap", 3).read_bytes()
    (here / "sessions" / "killed.mcap.abc123.part").write_bytes(whole[: len(whole) // 2])
    assert call(main, "ls") == 3
    output = capsys.readouterr()
    assert all(name in output.out for name in ("monday", "killed"))
    assert "killed.mcap.abc123.part" in output.err
    (here / "sessions" / "broken.mcap").write_bytes(b"garbage")
    assert call(main, "ls") in (1, 3)
    output = capsys.readouterr()
    assert "monday" in output.out
    assert "broken.mcap" in output.err


def test_without_logs_it_says_how_to_begin(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "ls") == 1
    assert "bc-record" in capsys.readouterr().err
    (here / "sessions").mkdir()
    assert call(main, "ls") == 1
    assert "bc-record" in capsys.readouterr().err
