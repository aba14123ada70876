"""`bc-log ls` lists sessions and drives, one line each."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from recorder.bc_pb2 import VehicleState
from recorder.log.writer import LogWriter
from recorder.log_cli import main
from recorder.sources.built_in_simulator import record_simulated
from recorder.sources.settings import SimulatedDrive
from recorder.upkeep.log_info import describe
from tests.helpers.logs import START_NS, STEP_NS, write_log
from tests.helpers.udacity import call, picture

DAY_NS = 24 * 3600 * 10**9


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
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


def test_sessions_and_drives_are_listed_the_newest_first(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log_of(project / "sessions" / "monday.mcap", 3)
    log_of(project / "sessions" / "tuesday.mcap", 5, START_NS + DAY_NS)
    log_of(project / "drives" / "wednesday.mcap", 4, START_NS + 2 * DAY_NS)
    assert names(capsys) == ["wednesday", "tuesday", "monday"]
    assert names(capsys, "--sort", "name") == ["wednesday", "monday", "tuesday"]  # drives/ before sessions/
    assert names(capsys, "--sort", "rows") == ["tuesday", "wednesday", "monday"]
    assert names(capsys, "sessions", "--sort", "rows") == ["tuesday", "monday"]
    assert names(capsys, "monday", "sessions", "monday") == ["tuesday", "monday"]  # each once


def test_a_line_shows_of_its_log(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = log_of(project / "sessions" / "monday.mcap", 30)
    assert call(main, "tag", log, "exclude", "--rows", 2, 4) == 0
    capsys.readouterr()
    assert call(main, "ls") == 0
    line = capsys.readouterr().out.splitlines()[1].split()
    assert (line[0], line[4], line[-1]) == ("monday", "30", "exclude")
    assert call(main, "ls", "--json") == 0
    printed = capsys.readouterr().out
    assert call(main, "info", "sessions/monday.mcap", "--json") == 0
    assert json.loads(printed) == json.loads(capsys.readouterr().out)


def test_unfinished_and_broken_logs_are_shown_as_such(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log_of(project / "sessions" / "monday.mcap", 3)
    whole = log_of(project / "elsewhere" / "killed.mcap", 3).read_bytes()
    (project / "sessions" / "killed.mcap.abc123.part").write_bytes(whole[: len(whole) // 2])
    assert call(main, "ls") == 3
    output = capsys.readouterr()
    assert all(name in output.out for name in ("monday", "killed"))
    assert "killed.mcap.abc123.part" in output.err
    (project / "sessions" / "broken.mcap").write_bytes(b"garbage")
    assert call(main, "ls") in (1, 3)
    output = capsys.readouterr()
    assert "monday" in output.out
    assert "broken.mcap" in output.err


def test_an_unreadable_log_next_to_an_unfinished_one_is_a_failure(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = log_of(project / "elsewhere" / "killed.mcap", 3).read_bytes()
    (project / "sessions").mkdir()
    (project / "sessions" / "killed.mcap.abc123.part").write_bytes(whole[: len(whole) // 2])
    (project / "sessions" / "broken.mcap").write_bytes(b"garbage")
    assert call(main, "ls") == 1
    assert "broken.mcap: not an MCAP log" in capsys.readouterr().err


def test_an_empty_log_has_no_start_and_the_next_step_is_a_recording(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = project / "sessions" / "empty.mcap"
    LogWriter(empty, {"source": "telemetry"}).close()
    assert describe(empty).start == ""
    for command in ("info", "check"):
        assert call(main, command, "empty") == 0
        output = capsys.readouterr()
        assert "1970" not in output.out
        assert output.err == "next: `bc-record NAME`: sessions/empty.mcap is empty\n"
    log_of(project / "sessions" / "monday.mcap", 3)
    assert names(capsys) == ["monday", "empty"]
    assert call(main, "info", "empty", "monday") == 0
    assert capsys.readouterr().err == "next: `bc-index`\n"


def test_without_logs_it_reports_how_to_begin(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "ls") == 1
    assert "bc-record" in capsys.readouterr().err
    (project / "sessions").mkdir()
    assert call(main, "ls") == 1
    assert "bc-record" in capsys.readouterr().err


def test_a_recording_of_simulated_time_has_the_date_of_its_file(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = project / "lake.mcap"
    record_simulated(SimulatedDrive(laps=0.002, recovery=0), path)
    before = path.read_bytes()
    os.utime(path, (1_800_000_000, 1_800_000_000))
    assert describe(path).start == "2027-01-15T08:00:00+00:00"
    assert call(main, "ls", path) == 0
    header, row = capsys.readouterr().out.splitlines()[:2]
    assert header.split()[1] == "date,"  # not when the drive began
    assert "2027-01-15 08:00" in row
    record_simulated(SimulatedDrive(laps=0.002, recovery=0), path, overwrite=True)
    assert path.read_bytes() == before


def test_odd_rows_are_counted_and_a_short_stop_is_not_odd(project: Path) -> None:
    speeds_mph = [*[0] * 60, *[9] * 20, 0, 0, *[9] * 20]
    with LogWriter(project / "a.mcap", {"source": "test"}) as writer:
        for row, speed_mph in enumerate(speeds_mph):
            writer.vehicle(START_NS + row * STEP_NS, row, VehicleState(speed_mph=speed_mph))
    assert describe(project / "a.mcap").odd_rows == {"parked": 60}
