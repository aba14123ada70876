"""A gap that the recorder has meant is no finding; what was lost beside it is, and so is every other gap."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from recorder import Log, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.findings import Findings
from recorder.log.meant_gaps import MeantGap
from recorder.log_cli import main
from recorder.upkeep.check import check
from recorder.upkeep.log_info import describe
from tests.helpers.logs import START_NS
from tests.helpers.udacity import call, jpeg

HUMAN, PILOT = "manual: a human drives", "manual: the pilot drives again"
EVENT = "not recorded: 1.000 s, the car was pushed off its line"
"""As logs of earlier versions have it: their rows have no seconds."""
GAP = MeantGap(1.0, "the car was pushed off its line")


def findings(path: Path) -> list[tuple[str, str]]:
    return [(finding.kind, finding.where) for finding in check(path).findings]


def log_of(
    path: Path, at_s: list[float], events: dict[float, str], gaps: dict[float, MeantGap] | None = None
) -> Path:
    with LogWriter(path, {"source": "test"}) as writer:
        write_rows(writer, at_s, events, gaps)
    return path


def write_rows(
    writer: LogWriter, at_s: list[float], events: dict[float, str], gaps: dict[float, MeantGap] | None = None
) -> None:
    for row, seconds in enumerate(at_s):
        time_ns = START_NS + round(seconds * 1e9)
        writer.picture("center", time_ns, row, jpeg(60 + row, 10 * row))
        state = VehicleState(steering=row / 10, speed_mph=9.0)
        writer.vehicle(time_ns, row, state, (gaps or {}).get(seconds))
        before = at_s[row - 1] if row else -1.0
        for at in sorted(at for at in events if before < at <= seconds):
            writer.event(START_NS + round(at * 1e9), events[at])


@pytest.mark.parametrize(
    ("at_s", "events", "expected"),
    [
        ([0.0, 0.1, 1.2, 1.3], {1.2: EVENT}, []),
        ([0.0, 0.1, 1.2, 1.3], {}, ["before row 2"]),
        ([0.0, 0.1, 1.2, 1.3], {1.3: EVENT}, ["before row 2"]),  # not at the row behind it
        ([0.0, 0.1, 3.2, 3.3], {3.2: EVENT}, ["before row 2"]),  # longer than the recorder tells
        ([2.0, 2.1, 0.0, 0.1], {0.0: EVENT}, ["before row 2"]),  # time goes back
        ([0.0, 0.1, 1.2, 1.3], {1.2: "not recorded: nothing"}, ["before row 2"]),
        ([0.0, 0.1, 1.2, 1.3], {1.2: "not recorded: inf s, "}, ["before row 2"]),
    ],
)
def test_a_gap_counts_unless_an_event_at_its_row_shows_its_length(
    tmp_path: Path, at_s: list[float], events: dict[float, str], expected: list[str]
) -> None:
    path = log_of(tmp_path / "a.mcap", at_s, events)
    assert findings(path) == [("gaps in time", where) for where in expected]


@pytest.mark.parametrize(
    ("at_s", "gaps", "expected"),
    [
        ([0.0, 0.1, 1.2, 1.3], {1.2: GAP}, []),
        ([0.0, 0.1, 1.2, 1.3], {1.3: GAP}, ["before row 2"]),  # not at the row behind it
        ([0.0, 0.1, 3.2, 3.3], {3.2: GAP}, ["before row 2"]),  # longer than the recorder tells
        ([0.0, 0.1, 1.2, 1.3], {1.2: MeantGap(math.inf, "")}, ["before row 2"]),
    ],
)
def test_a_gap_counts_unless_the_row_behind_it_has_its_length(
    tmp_path: Path, at_s: list[float], gaps: dict[float, MeantGap], expected: list[str]
) -> None:
    path = log_of(tmp_path / "a.mcap", at_s, {}, gaps)
    assert findings(path) == [("gaps in time", where) for where in expected]
    assert describe(path).meant_gaps == ([] if expected else [2])


@pytest.mark.parametrize(
    ("events", "expected"),
    [
        ({0.2: HUMAN, 3.2: PILOT}, []),
        ({0.2: HUMAN, 3.1: PILOT}, []),  # as earlier versions wrote it: right before the row
        ({0.2: HUMAN, 1.0: PILOT, 1.5: HUMAN, 3.2: "manual: telemetry comes again"}, []),
        ({1.5: HUMAN, 3.2: PILOT}, ["before row 2"]),  # more than a second before it
        ({0.2: HUMAN, 1.9: PILOT}, ["before row 2"]),  # and behind it
        ({0.2: HUMAN, 1.0: "disconnected: transport close"}, ["before row 2"]),
        ({0.05: HUMAN, 3.2: PILOT}, ["before row 2"]),  # a row lies within
        ({3.2: PILOT}, ["before row 2"]),
    ],
)
def test_a_gap_in_which_a_human_drove_is_no_finding(
    tmp_path: Path, events: dict[float, str], expected: list[str]
) -> None:
    path = log_of(tmp_path / "a.mcap", [0.0, 0.1, 3.2, 3.3], events)
    assert findings(path) == [("gaps in time", where) for where in expected]
    copy = tmp_path / "copy.mcap"  # its writer reads the events
    assert call(main, "rewrite", path, "--to", copy) == 0
    assert describe(copy).meant_gaps == ([] if expected else [2])


def test_rows_that_are_cut_out_are_missed(tmp_path: Path) -> None:
    """In a log that was made of parts, an event that was meant for another gap hides none."""
    at_s = [0.0, 0.1, 1.2, 1.3, 2.9, 3.0, 3.1, 4.2, 4.3]
    path = log_of(tmp_path / "a.mcap", at_s, {4.2: EVENT}, {1.2: GAP, 2.9: GAP})
    assert findings(path) == []
    assert call(main, "trim", path, "--rows", 0, 1, "--to", tmp_path / "begin.mcap") == 0
    assert call(main, "trim", path, "--rows", 4, 8, "--to", tmp_path / "end.mcap") == 0
    both = tmp_path / "both.mcap"
    assert call(main, "merge", tmp_path / "begin.mcap", tmp_path / "end.mcap", "--to", both) == 0
    assert findings(both) == [("gaps in time", "before row 6")]


def test_the_log_reports_itself_which_gaps_were_meant(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """So that `bc-log info` and the list of sessions need not read it all; a log made of it says so, too."""
    path = log_of(tmp_path / "a.mcap", [0.0, 0.1, 1.2, 1.3, 3.4, 3.5], {}, {1.2: GAP})
    part = tmp_path / "part.mcap"
    assert call(main, "trim", path, "--rows", 1, 5, "--to", part) == 0
    for log in (path, part):
        assert describe(log).meant_gaps == [2]
    capsys.readouterr()
    assert call(main, "info", path) == 0
    printed = capsys.readouterr().out
    assert "1 gap that its events explain" in printed
    assert "gap: rows 4 to 4" in printed
    assert "gap: rows 2 to 2" not in printed


def test_an_unfinished_log_is_asked_for_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recorder.log.writer.FLUSH_S", 0.0)
    killed = tmp_path / "killed.mcap.0123ab.part"
    with LogWriter(tmp_path / "a.mcap", {"source": "test"}, live=True) as writer:
        write_rows(writer, [0.0, 0.1, 1.2, 1.3], {1.2: EVENT})
        writer.flush_if_due()
        killed.write_bytes(writer.part.read_bytes())
    info = describe(killed)
    assert "unfinished" in info.notice
    assert info.meant_gaps == [2]


@pytest.mark.parametrize("stored", ["", "{}", "[1.5]", '["a"]', "[[[", "[1e99]"])
def test_what_another_program_reports_of_them_is_no_error(stored: str, tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", {"source": "test"}) as writer:
        writer.vehicle(START_NS, 0, VehicleState())
    with Log(tmp_path / "a.mcap") as log:
        quality = log.read_metadata("bc.quality")
    found = Findings.from_metadata({**quality, "meant_gaps": stored})
    assert found is not None
    assert found.meant_gaps == []


def test_a_pause_of_a_recorder_that_people_switch_is_no_finding(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, {"source": "udacity"}) as writer:
        write_rows(writer, [0.0, 0.1, 5.0, 5.1, 9.0], {})
    assert call(main, "check", path) == 0
    first, pauses = capsys.readouterr().out.splitlines()
    assert first.endswith("nothing wrong")
    assert pauses.endswith("a new drive begins after each: 2 (before row 2, before row 4)")


@pytest.mark.parametrize(("source", "code"), [("udacity", 0), ("drive", 3)])
def test_a_clock_that_is_set_back_is_not_called_a_pause(
    source: str, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, {"source": source}) as writer:
        write_rows(writer, [3600.0, 3600.1, 0.2, 0.3], {})
    assert call(main, "check", path) == code
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "  jumps back in time; a new drive begins after each: 1 (before row 2)"
    assert not [line for line in lines if "pauses" in line]
    assert [odd.where for odd in check(path).findings] == ["before row 2"] * (code == 3)
