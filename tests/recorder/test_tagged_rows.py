"""Odd rows that somebody has looked at and tagged `fine` are not named again."""

from __future__ import annotations

from pathlib import Path

import pytest

from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.tagged_rows import TaggedRows
from recorder.log.tags import Tag
from recorder.log_cli import main
from udacity import call


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Eight seconds of driving, seven of standing, five more, a pause of ten, five of driving."""
    path = tmp_path / "a.mcap"
    with LogWriter(path, {"source": "test"}) as writer:
        for row in range(250):
            pedal, speed_mph = (0.0, 0.0) if 80 <= row < 150 else (0.5, 8.0)
            state = VehicleState(steering=row / 1000, throttle=pedal, speed_mph=speed_mph)
            writer.vehicle(row * 10**8 + (10**10 if row >= 200 else 0), row, state)
    return path


@pytest.mark.parametrize("words", [("check",), ("info",), ("ls",), ("tag", "exclude", "--odd")])
def test_odd_rows_that_are_fine_are_not_named(
    words: tuple[str, ...], log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def printed() -> str:
        call(main, words[0], log, *words[1:])
        output = capsys.readouterr()
        return output.out + output.err

    call(main, "tag", log, "fine", "--rows", 80, 149)
    capsys.readouterr()
    assert "parked" not in printed().replace("fine", "")
    call(main, "tag", log, "fine", "--remove")
    capsys.readouterr()
    assert "parked" in printed()


def test_a_gap_that_is_fine_is_no_finding(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call(main, "tag", log, "fine", "--rows", 80, 149)
    call(main, "check", log)
    assert "before row 200" in capsys.readouterr().out
    call(main, "tag", log, "fine", "--rows", 199, 200)
    call(main, "check", log)
    assert "before row 200" not in capsys.readouterr().out


@pytest.mark.parametrize(("rows", "is_fine"), [((5, 20), True), ((0, 9), True), ((5, 21), False)])
def test_rows_are_fine_only_if_all_of_them_are_tagged(rows: tuple[int, int], *, is_fine: bool) -> None:
    tags = [Tag(0, 9, "fine"), Tag(10, 20, "fine"), Tag(21, 40, "exclude")]
    assert TaggedRows(tags).cover(*rows) == is_fine
