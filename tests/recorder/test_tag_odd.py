"""`bc-log tag --odd` and `--where`: what was found, or a condition, is listed first, tagged, and undone. Odd rows
that somebody has looked at and tagged `fine` are not named again.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from recorder import LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log.tags import Tag, TaggedRows
from recorder.log_cli import main
from recorder.rows.odd_stretches import OddStretch
from tests.helpers.logs import tags_of, write_log
from tests.helpers.udacity import call, picture


@pytest.fixture
def parked(tmp_path: Path) -> Path:
    """Eight seconds of driving, seven of standing, five of driving, a pause of ten, three of driving."""
    path = tmp_path / "a.mcap"
    with LogWriter(path, {"source": "test"}) as writer:
        for row in range(230):
            pedal, speed_mph = (0.0, 0.0) if 80 <= row < 150 else (0.5, 8.0)
            state = VehicleState(steering=row / 1000, throttle=pedal, speed_mph=speed_mph)
            writer.vehicle(row * 10**8 + (10**10 if row >= 200 else 0), row, state)
    return path


def test_what_is_surely_odd_is_listed_tagged_and_taken_back(
    parked: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(main, "tag", parked, "exclude", "--odd") == 0
    output = capsys.readouterr()
    assert output.err.startswith("parked: rows 80 to 149, 8.0 to 14.9 s (stands for 7 s)")
    assert output.out == "exclude: rows 80 to 149\n"
    assert tags_of(parked) == [(80, 149, "exclude")]
    assert call(main, "tag", parked, "exclude", "--odd", "--remove") == 0
    assert tags_of(parked) == []


def test_rows_for_which_a_condition_holds_are_tagged_as_stretches(parked: Path) -> None:
    assert call(main, "tag", parked, "exclude", "--where", "speed_mph > 2 and (time_s < 0.5 or row >= 228)") == 0
    assert tags_of(parked) == [(0, 4, "exclude"), (228, 229, "exclude")]
    assert call(main, "tag", parked, "exclude", "--where", "row >= 228", "--remove") == 0
    assert tags_of(parked) == [(0, 4, "exclude")]


def test_where_nothing_is_found_nothing_is_tagged(parked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(main, "tag", parked, "exclude", "--where", "speed_mph > 100") == 1
    assert "no row meets this condition; nothing was tagged" in capsys.readouterr().err
    assert tags_of(parked) == []
    clean = write_log(parked.with_name("clean.mcap"), [0.1 * (row % 7) for row in range(60)])
    assert call(main, "tag", clean, "exclude", "--odd") == 0
    assert "nothing that is surely odd; nothing was tagged" in (shown := capsys.readouterr().err)
    assert "next:" not in shown


def test_a_check_advises_to_exclude_only_what_it_finds_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    noted = OddStretch("parked", 3, 9, 0.3, 0.9, "by the rules of an earlier version", is_sure=True)
    monkeypatch.setattr("recorder.log.findings.odd_stretches", lambda states: [noted])
    log = write_log(tmp_path / "a.mcap", [0.1 * (row % 7) for row in range(60)], picture)
    assert call(main, "info", log) == 0
    assert "exclude --odd" in capsys.readouterr().err
    assert call(main, "check", log) == 0
    assert "exclude" not in capsys.readouterr().err


@pytest.mark.parametrize(("answer", "expected"), [(True, [(80, 149, "exclude")]), (False, [])])
def test_a_person_is_asked_once_it_is_listed(
    answer: bool, expected: list[object], parked: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def ask(question: str) -> bool:
        asked.append(question)
        return answer

    monkeypatch.setattr("recorder.log_tag_cli.ask", ask)
    assert call(main, "tag", parked, "exclude", "--odd") == (0 if answer else 1)
    assert asked == ["Tag 70 rows in 1 stretch 'exclude'?"]
    assert tags_of(parked) == expected
    assert call(main, "tag", parked, "exclude", "--odd", "--yes") == 0
    assert (len(asked), tags_of(parked)) == (1, [(80, 149, "exclude")])


@pytest.mark.parametrize(
    ("flags", "shown"),
    [
        (("--odd", "--rows", 1, 2), "give one of --odd, --where"),
        (("--where", "row = 1", "--odd"), "give one of --odd, --where"),
        (("--look", "--rows", 1, 2), "--look: give --odd, too"),
        (("--where", "speed < 2"), "no column speed (did you mean speed_mph?); columns are row,"),
    ],
)
def test_flags_that_contradict_each_other_are_a_mistake(
    flags: tuple[object, ...], shown: str, parked: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(main, "tag", parked, "exclude", *flags) == 2
    assert shown in capsys.readouterr().err
    assert tags_of(parked) == []


# Rows that are fine


@pytest.mark.parametrize("words", [("check",), ("info",), ("ls",), ("tag", "exclude", "--odd")])
def test_odd_rows_that_are_fine_are_not_named(
    words: tuple[str, ...], parked: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def printed() -> str:
        call(main, words[0], parked, *words[1:])
        output = capsys.readouterr()
        return output.out + output.err

    call(main, "tag", parked, "fine", "--rows", 80, 149)
    capsys.readouterr()
    assert "parked" not in printed().replace("fine", "")
    call(main, "tag", parked, "fine", "--remove")
    capsys.readouterr()
    assert "parked" in printed()


def test_a_gap_that_is_fine_is_no_finding(parked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call(main, "tag", parked, "fine", "--rows", 80, 149)
    call(main, "check", parked)
    assert "before row 200" in capsys.readouterr().out
    call(main, "tag", parked, "fine", "--rows", 199, 200)
    call(main, "check", parked)
    assert "before row 200" not in capsys.readouterr().out


@pytest.mark.parametrize(("rows", "is_fine"), [((5, 20), True), ((0, 9), True), ((5, 21), False)])
def test_rows_are_fine_only_if_all_of_them_are_tagged(rows: tuple[int, int], *, is_fine: bool) -> None:
    tags = [Tag(0, 9, "fine"), Tag(10, 20, "fine"), Tag(21, 40, "exclude")]
    assert TaggedRows(tags).cover(*rows) == is_fine
