"""`bc-doctor` says what is in a project, what is odd in it, how good it is, and what to do next."""

from __future__ import annotations

import json
import os
import shlex
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from dataset import IndexConfig, build_index
from drive.doctor import examine
from drive.doctor_cli import main
from recorder.log_cli import main as log_command
from tests.helpers.bytes_read import count_bytes, note_reads
from tests.helpers.driving import untrained_run
from tests.helpers.histories import epoch_line
from tests.helpers.logs import START_NS, write_log
from tests.helpers.udacity import call

STEERING = [0.1 * (row % 7 - 3) for row in range(60)]


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A project with two sessions, their index, a run and a drive."""
    monkeypatch.chdir(tmp_path)
    for name in ("sessions", "drives"):
        Path(name).mkdir()
    logs = [
        write_log(Path("sessions") / f"{name}.mcap", STEERING, start_ns=START_NS + day * 10**14)
        for day, name in enumerate(("monday", "sunday"))
    ]
    build_index(logs, Path("index"), IndexConfig(block_s=0.5, gap_s=0, labels="as-recorded"))
    run = untrained_run(Path("runs") / "first")
    line = epoch_line(1)
    line["mean"]["balanced_rmse_deg"] = 40.0
    (run / "metrics.jsonl").write_text(json.dumps(line) + "\n")
    write_log(Path("drives") / "one.mcap", STEERING, source="drive")


def commands() -> list[str]:
    return [advice.command for advice in examine().advice]


def test_an_empty_folder_gets_three_ways_to_begin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, tmp_path) == 0
    *folders, first, second, third = capsys.readouterr().out.replace(".venv/bin/", "").splitlines()
    assert folders == ["sessions: no logs", "index: none", "runs: none", "drives: no logs"]
    for line, program in ((first, "bc-demo"), (second, "bc-record lake"), (third, "bc-import ~/recording mine")):
        assert line.startswith(f"next: `cd {shlex.quote(str(tmp_path))} && ")
        assert program in line


@pytest.mark.usefixtures("project")
def test_a_project_is_said_in_a_line_a_folder(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "sessions: 2 logs, 120 rows, 0.2 min"
    assert lines[1].startswith("index: 2 sessions, ")
    assert lines[2] == "runs: 1, the newest is first"
    assert lines[3] == "drives: 1 log, 60 rows, 0.1 min"
    (good,) = (line for line in lines if line.startswith("how good: first: "))
    assert "on turns (12.00 against 9.00 degrees)" in good
    assert sum(line.startswith("next: `") for line in lines) == 3
    assert call(main, "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert len(printed["advice"]) == 3
    assert printed["problems"] == []


@pytest.mark.usefixtures("project")
def test_what_is_new_is_the_next_thing_to_do() -> None:
    write_log(Path("sessions") / "new.mcap", STEERING)
    project = examine()
    assert "index: does not hold new" in project.odd
    assert project.advice[0].command == "bc-index"
    Path("index/samples.parquet").unlink()
    assert commands()[0] == "bc-index"


@pytest.mark.usefixtures("project")
def test_odd_rows_are_named_with_their_longest_stretch() -> None:
    steering = [0.1] * 60
    write_log(Path("sessions") / "sunday.mcap", steering, overwrite=True)
    odd = [line for line in examine().odd if "sunday" in line and "odd row" in line]
    assert odd == [
        "sessions/sunday.mcap: 60 odd rows of 60 (steering that never changes: 60); the longest stretch: rows 0 to"
        " 59"
    ]
    assert not any("monday" in line for line in examine().odd)


@pytest.mark.usefixtures("project")
def test_what_is_perhaps_odd_is_to_be_looked_at() -> None:
    write_log(Path("sessions") / "sunday.mcap", [0.1] * 60, overwrite=True)
    assert "bc-log check sessions/sunday.mcap" in commands()
    before = examine().advice
    assert call(log_command, "tag", "sessions/sunday.mcap", "exclude", "--start", 0) == 0
    os.utime("sessions/sunday.tags.jsonl", (2e9, 2e9))  # whatever the clock's steps are
    assert (
        next(advice for advice in examine().advice if advice not in before).why == "tags are newer than the index"
    )
    assert "bc-log check sessions/sunday.mcap" not in commands()
    write_log(Path("sessions") / "sunday.mcap", [3.0] * 30 + STEERING[:30], overwrite=True)
    assert any("values out of range: 30" in line for line in examine().odd)
    assert not any("sunday" in command for command in commands())


@pytest.mark.usefixtures("project")
@pytest.mark.parametrize("damage", ["log", "index", "config", "metrics", "results"])
def test_a_bad_file_hides_nothing_else(damage: str, capsys: pytest.CaptureFixture[str]) -> None:
    bad: dict[str, tuple[str, str, str]] = {
        "log": ("sessions/sunday.mcap", "sunday.mcap", "bc-log recover sessions/sunday.mcap"),
        "index": ("index/samples.parquet", "samples.parquet", "bc-index"),
        "config": ("runs/first/config.json", "config.json", ""),
        "metrics": ("runs/first/metrics.jsonl", "", ""),
        "results": ("runs/first/results.jsonl", "", ""),
    }
    path, name, command = bad[damage]
    Path(path).write_bytes(b"\x89nonsense\n" * 30)
    code = call(main)
    shown = capsys.readouterr()
    assert code == (3 if name else 0)
    assert name in shown.err
    for folder in ("sessions: 2 logs", "index" if damage == "index" else "index: 2", "runs: 1", "drives: 1"):
        assert folder in shown.out or f"{folder}/" in shown.err
    if command:
        assert f"{command}`" in shown.out


@pytest.mark.usefixtures("project")
def test_it_reads_ends_of_logs_and_no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    def big(camera: Any, row: int) -> bytes:
        return b"\xff" * 20_000

    write_log(Path("sessions") / "long.mcap", STEERING * 10, big)
    assert Path("sessions/long.mcap").stat().st_size > 36_000_000
    read = note_reads(monkeypatch)
    assert "sessions: 3 logs" in examine().here[0]
    assert 1000 < count_bytes(read) < 100_000


def test_a_folder_that_is_not_there_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, tmp_path / "nowhere") == 1
    assert "nowhere: no such folder" in capsys.readouterr().err
    (tmp_path / "a.mcap").touch()
    assert call(main, tmp_path / "a.mcap") == 1
    assert "a.mcap: a file, not a folder" in capsys.readouterr().err


@pytest.mark.usefixtures("project")
def test_an_earlier_versions_index_is_said() -> None:
    build_index([Path("sessions") / "monday.mcap"], Path("index"), IndexConfig(block_s=0.5, gap_s=0))
    assert not any("earlier version" in line for line in examine().odd)
    file = Path("index/samples.parquet")
    table = pq.read_table(file)
    stored = json.loads(table.schema.metadata[b"bc.index"])
    del stored["counts"]["monday"]["not_measured"]
    pq.write_table(table.replace_schema_metadata({b"bc.index": json.dumps(stored).encode()}), file)
    project = examine()
    assert (
        "index: built by an earlier version, which held out crashes and did not detect all odd frames"
        in project.odd
    )
    assert project.advice[0].command == "bc-index"
