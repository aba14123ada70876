"""`bc-log ls` lists sessions and drives, one line each."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from mcap.writer import Writer as McapWriter

from common.car import Camera
from logs import START_NS, STEP_NS, write_log
from recorder import Log
from recorder.bc_pb2 import VehicleState
from recorder.log.writer import LogWriter
from recorder.log_cli import main
from recorder.sources.built_in_simulator import record_simulated
from recorder.sources.settings import SimulatedDrive
from recorder.upkeep.log_info import describe
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


def hostile(path: Path, name: str, values: dict[str, str]) -> Path:
    """A log of another program, whose metadata `name` has these values."""
    path.parent.mkdir(exist_ok=True)
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("bc", "somebody")
        writer.add_metadata(name, values)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


@pytest.mark.parametrize(
    ("name", "key"),
    [
        *(("bc.quality", key) for key in ("steering", "stretches", "picture_sizes", "meant_gaps")),
        ("bc.quality", "first_picture_px"),
        *(("bc.session", key) for key in ("car", "drive.speed")),
    ],
)
@pytest.mark.parametrize("depth", [600, 5000])
def test_metadata_that_is_nested_deep_hides_no_log(
    name: str, key: str, depth: int, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log_of(here / "sessions" / "monday.mcap", 3)
    log = hostile(here / "sessions" / "deep.mcap", name, {key: '{"a":' * depth + "1" + "}" * depth})
    assert names(capsys) == ["monday", "deep"]
    assert call(main, "info", log, here / "sessions" / "monday.mcap") == 0
    assert "monday.mcap" in capsys.readouterr().out


def test_a_failure_nobody_expects_hides_no_log(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("monday", "tuesday"):
        log_of(here / "sessions" / f"{name}.mcap", 3)

    def fails_on_monday(log: Log) -> dict[str, str]:
        if "monday" in log.path.name:
            raise ZeroDivisionError("of a library")
        return {}

    monkeypatch.setattr(Log, "metadata", property(fails_on_monday))
    assert call(main, "ls") == 1
    output = capsys.readouterr()
    assert "tuesday" in output.out
    assert "sessions/monday.mcap: cannot be read (ZeroDivisionError of a library)" in output.err


def test_a_recording_of_simulated_time_has_the_date_of_its_file(here: Path) -> None:
    path = here / "lake.mcap"
    record_simulated(SimulatedDrive(laps=0.01, recovery=0), path)
    before = path.read_bytes()
    os.utime(path, (1_800_000_000, 1_800_000_000))
    assert describe(path).start == "2027-01-15T08:00:00+00:00"
    record_simulated(SimulatedDrive(laps=0.01, recovery=0), path, overwrite=True)
    assert path.read_bytes() == before


def test_a_car_that_starts_is_not_odd(here: Path) -> None:
    def log_at(path: Path, *speeds_mph: float) -> Path:
        with LogWriter(path, {"source": "test"}) as writer:
            for row, speed_mph in enumerate(speeds_mph):
                writer.vehicle(START_NS + row * STEP_NS, row, VehicleState(speed_mph=speed_mph))
        return path

    assert describe(log_at(here / "starts.mcap", *[0] * 20, *[9] * 20)).odd_rows == {}
    assert describe(log_at(here / "stops.mcap", *[9] * 20, 0, 0, *[9] * 20)).odd_rows == {}
    assert describe(log_at(here / "parked.mcap", *[0] * 60, *[9] * 20)).odd_rows == {"parked": 60}
