"""A gap that the recorder has meant is no finding; what was lost beside it is, and so is every other gap."""

from __future__ import annotations

from pathlib import Path

import pytest

from logs import START_NS
from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.check import check
from recorder.log_cli import main
from udacity import call, jpeg

EVENT = "not recorded: 1.000 s, the car was pushed off its line"


def findings(path: Path) -> list[tuple[str, str]]:
    return [(found.kind, found.where) for found in check(path).findings]


def log_of(path: Path, at_s: list[float], events: dict[float, str]) -> Path:
    with LogWriter(path, {"source": "test"}) as writer:
        for row, seconds in enumerate(at_s):
            time_ns = START_NS + round(seconds * 1e9)
            writer.picture("center", time_ns, row, jpeg(60 + row, 10 * row))
            writer.vehicle(time_ns, row, VehicleState(steering=row / 10, speed_mph=9.0))
            if seconds in events:
                writer.event(time_ns, events[seconds])
    return path


@pytest.mark.parametrize(
    ("at_s", "events", "found"),
    [
        ([0.0, 0.1, 1.2, 1.3], {1.2: EVENT}, []),
        ([0.0, 0.1, 1.2, 1.3], {}, ["before row 2"]),
        ([0.0, 0.1, 1.2, 1.3], {1.3: EVENT}, ["before row 2"]),  # not at the row behind it
        ([0.0, 0.1, 3.2, 3.3], {3.2: EVENT}, ["before row 2"]),  # longer than the recorder tells
        ([0.0, 0.1, 1.2, 4.3], {1.2: EVENT}, ["before row 3"]),
        ([2.0, 2.1, 0.0, 0.1], {0.0: EVENT}, ["before row 2"]),  # time goes back
        ([0.0, 0.1, 1.2, 1.3], {1.2: "not recorded: nothing"}, ["before row 2"]),
        ([0.0, 0.1, 1.2, 1.3], {1.2: "not recorded: inf s, "}, ["before row 2"]),
    ],
)
def test_a_gap_counts_unless_an_event_at_its_row_tells_its_length(
    tmp_path: Path, at_s: list[float], events: dict[float, str], found: list[str]
) -> None:
    path = log_of(tmp_path / "a.mcap", at_s, events)
    assert findings(path) == [("gaps in time", where) for where in found]


def test_rows_that_are_cut_out_are_missed(tmp_path: Path) -> None:
    """In a log that was made of parts, an event that was meant for another gap hides none."""
    at_s = [0.0, 0.1, 1.2, 1.3, 2.9, 3.0, 3.1, 4.2, 4.3]
    path = log_of(tmp_path / "a.mcap", at_s, {1.2: EVENT, 2.9: EVENT, 4.2: EVENT})
    assert findings(path) == []
    assert call(main, "trim", path, "--rows", 0, 1, "--to", tmp_path / "begin.mcap") == 0
    assert call(main, "trim", path, "--rows", 4, 8, "--to", tmp_path / "end.mcap") == 0
    both = tmp_path / "both.mcap"
    assert call(main, "merge", tmp_path / "begin.mcap", tmp_path / "end.mcap", "--to", both) == 0
    assert findings(both) == [("gaps in time", "before row 6")]
