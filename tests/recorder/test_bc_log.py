"""`bc-log`: what it prints and how it ends. (What its edits hold is in test_edit_logs.py.)"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from common.location import Location
from recorder import LogError, LogWriter
from recorder.bc_pb2 import VehicleState
from recorder.log_cli import main
from recorder.upkeep.check import check, is_whole
from recorder.upkeep.check_contents import Finding
from tests.helpers.driving import PATIENCE_S, command, environment, one_line_in
from tests.helpers.logs import START_NS, STEP_NS, flip_bit, read_messages, write_log
from tests.helpers.places import Place
from tests.helpers.plain_mcap import contents
from tests.helpers.udacity import call, jpeg, picture


def log_with(path: Path, rows: list[tuple[float, float, float, bytes | None]]) -> Path:
    """A log of rows (seconds, steering, speed, centre picture)."""
    with LogWriter(path, {"source": "test"}) as writer:
        for row, (at_s, steering, speed_mph, data) in enumerate(rows):
            time_ns = START_NS + round(at_s * 1e9)
            if data is not None:
                writer.picture("center", time_ns, row, data)
            writer.vehicle(time_ns, row, VehicleState(steering=steering, throttle=0.5, speed_mph=speed_mph))
    return path


def found_in(path: Location, **options: bool) -> list[tuple[str, str]]:
    return [(finding.kind, finding.where) for finding in check(path, **options).findings]


# check


def test_nothing_is_wrong_with_a_sound_log(
    tmp_path: Path, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1, -0.2, 0.3], picture)
    assert call(main, "check", place(path)) == 0
    assert capsys.readouterr().out == f"{place(path)}: 12 messages, 9 pictures decoded: nothing wrong\n"


def test_what_the_rows_and_pictures_have_wrong_is_found(tmp_path: Path) -> None:
    good = [jpeg(40 + row, row + 1) for row in range(120)]
    rows: list[tuple[float, float, float, bytes | None]] = [
        (row / 10, row / 200, 9.0, good[row]) for row in range(120)
    ]
    rows[10] = (1.0, 0.05, 9.0, None)
    for row in (20, 21, 22):
        rows[row] = (row / 10, row / 200, 9.0, good[20])
    rows[30] = (3.0, 1.5, 9.0, good[30])
    for row in range(50, 90):  # four seconds of the very same steering
        rows[row] = (row / 10, 0.25, 9.0, good[row])
    rows[100] = (10.0, 0.5, 9.0, b"\xff\xd8\xffno picture\xff\xd9")
    rows[110:] = [(at_s + 5, *rest) for at_s, *rest in rows[110:]]  # type: ignore[misc]
    path = log_with(tmp_path / "a.mcap", rows)
    assert sorted(found_in(path)) == [
        ("gaps in time", "before row 110"),
        ("pictures that do not decode", "/camera/center row 100"),
        ("stretches of frozen pictures", "/camera/center rows 20 to 22"),
        ("stretches of rows without a picture", "/camera/center row 10"),
        ("stretches of stuck steering", "rows 50 to 89"),
        ("stretches of values out of range", "row 30"),
    ]
    assert ("pictures that do not decode", "/camera/center row 100") not in found_in(path, look=False)


def test_pictures_without_a_row_and_rows_out_of_order_are_found(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, {"source": "test"}) as writer:
        for row in (0, 3, 2, 1):  # pictures may come in any order, rows may not
            writer.picture("center", START_NS + row * STEP_NS, row, jpeg(50 + row))
            if row != 1:
                writer.vehicle(START_NS + row * STEP_NS, row, VehicleState(speed_mph=9))
    assert sorted(found_in(path)) == [
        ("gaps in time", "before row 2"),
        ("rows out of order", "/vehicle row 2"),
        ("stretches of pictures without a row", "/camera/center row 1"),
    ]


@pytest.mark.parametrize("every", [17, pytest.param(1, marks=pytest.mark.long)])
def test_every_flipped_byte_is_found(tmp_path: Path, every: int) -> None:
    """The CRCs of the chunks, of all data and of the summary cover the whole file."""
    whole = write_log(tmp_path / "a.mcap", [0.1], lambda camera, row: camera.encode()).read_bytes()
    path = tmp_path / "flipped.mcap"
    unseen = []
    for at in range(0, len(whole), every):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        try:
            is_found = bool(check(path, look=False).findings)
        except LogError:
            is_found = True
        if not is_found:
            unseen.append(at)
    assert unseen == []


def test_a_clock_of_whole_seconds_is_a_finding(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with LogWriter(tmp_path / "a.mcap", {"source": "csv"}) as writer:
        for row in range(12):
            writer.picture("center", row // 4 * 10**9, row, picture("center", row))
            writer.vehicle(row // 4 * 10**9, row, VehicleState(steering=row / 100, speed_mph=9.0))
    assert call(main, "check", tmp_path / "a.mcap") == 3
    reported = "stretches of rows at the same time: 3 (rows 0 to 3, rows 4 to 7, rows 8 to 11)"
    assert reported in capsys.readouterr().out


def test_a_finding_ends_with_3_and_json_shows_each(
    tmp_path: Path, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1, 2.0, 0.3], picture)
    assert call(main, "check", place(path)) == 3
    assert capsys.readouterr().out.splitlines() == [
        f"{place(path)}: 12 messages, 9 pictures decoded: 1 finding",
        "  values out of range: row 1, 0.1 to 0.1 s (steering, a pedal or a speed that no car has)",
        *[f"  `bc-log tag {path} exclude --odd` excludes all that is sure"] * (place(path) == path),
    ]
    assert call(main, "check", place(path), "--json") == 3
    reported = json.loads(capsys.readouterr().out)
    assert reported["findings"] == [Finding("stretches of values out of range", "row 1")._asdict()]
    assert (reported["messages"], reported["pictures_decoded"]) == (12, 9)


def test_an_unfinished_log_is_checked_as_far_as_it_goes(
    tmp_path: Path, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1] * 40, lambda camera, row: bytes(20_000))
    os.truncate(path, path.stat().st_size // 2)
    assert call(main, "check", "--no-look", place(path)) == 3
    assert "no readable end" in capsys.readouterr().out


# info


def info_of(path: Location, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    call(main, "info", path, "--json")
    reported: dict[str, Any] = json.loads(capsys.readouterr().out)
    return reported


def test_info_shows_what_is_in_a_log(tmp_path: Path, place: Place, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1] * 21, picture)
    reported = info_of(place(path), capsys)
    assert reported["duration_s"] == pytest.approx(2.0)
    assert reported["size_bytes"] == path.stat().st_size
    assert reported["session"]["source"] == "test"
    assert reported["start"] == "2024-07-13T14:13:20+00:00"
    topics = {topic["topic"]: topic for topic in reported["topics"]}
    assert topics["/vehicle"] == {
        "topic": "/vehicle",
        "schema": "bc.VehicleState",
        "messages": 21,
        "per_second": pytest.approx(10.5),
    }
    assert {topic: value["messages"] for topic, value in topics.items()} == {
        topic: len(messages) for topic, messages in read_messages(path).items()
    }


def test_info_shows_gaps_odd_rows_and_tags(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows: list[tuple[float, float, float, bytes | None]] = [(row / 10, 0.1, 9.0, jpeg(50)) for row in range(10)]
    rows += [(30 + row / 10, 0.1, 0.0, jpeg(50)) for row in range(10)]
    path = log_with(tmp_path / "a.mcap", rows)
    assert call(main, "tag", path, "recovery", "--rows", 3, 5) == 0
    capsys.readouterr()
    reported = info_of(path, capsys)
    assert reported["drives"] == 2
    assert {flag: count for flag, count in reported["flags"].items() if count} == {"gap": 1, "standing_still": 10}
    assert reported["odd"] == []
    assert {tuple(stretch.values()) for stretch in reported["stretches"]} == {
        ("gap", 10, 10, 0.9, 30.0),
        ("standing_still", 10, 19, 30.0, 30.9),
    }
    assert reported["tags"] == [{"first_row": 3, "last_row": 5, "name": "recovery"}]
    assert call(main, "info", path) == 0
    printed = capsys.readouterr().out
    assert "2 drives" in printed
    assert "tag recovery: rows 3 to 5" in printed


def test_info_reads_only_the_end_of_a_finished_log(
    tmp_path: Path, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    """All chunks are overwritten, and it says the same."""
    path = write_log(tmp_path / "a.mcap", [0.1] * 21, lambda camera, row: bytes(50_000))
    before = info_of(place(path), capsys)
    with path.open("rb+") as stream:
        stream.seek(500)
        stream.write(b"\xaa" * 3_000_000)
    assert info_of(place(path), capsys) == before


def test_info_of_an_unfinished_log_reports_so(
    tmp_path: Path, place: Place, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("recorder.mcap.split_chunks.CHUNK_BYTES", 1000)
    path = write_log(tmp_path / "a.mcap", [0.1] * 40, lambda camera, row: bytes(20_000))
    os.truncate(path, path.stat().st_size // 2)
    assert call(main, "info", place(path)) == 3
    shown = capsys.readouterr()
    assert "a.mcap: unfinished" in shown.err
    assert f"bc-log recover {place(path)}" in shown.err
    assert "1 drive" in shown.out


# tag, trim and the others, as commands


def test_tags_are_given_listed_and_removed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1] * 50)
    assert call(main, "tag", path) == 0
    assert capsys.readouterr() == ("", f"{path}: no tags\n")
    assert call(main, "tag", path, "exclude", "--start", 1, "--end", 2) == 0
    assert call(main, "tag", path, "exclude", "--rows", 40, 45) == 0
    assert call(main, "tag", path, "whole drive", "--start", 0) == 0
    capsys.readouterr()
    assert call(main, "tag", path) == 0
    assert capsys.readouterr().out.splitlines() == [
        "whole drive: rows 0 to 49",
        "exclude: rows 10 to 20",
        "exclude: rows 40 to 45",
    ]
    assert call(main, "tag", path, "exclude", "--rows", 40, 45, "--remove") == 0
    shown = capsys.readouterr()
    assert shown.out.splitlines() == ["whole drive: rows 0 to 49", "exclude: rows 10 to 20"]
    removed, advice = shown.err.splitlines()
    assert (removed, "bc-index`" in advice) == ("removed exclude: rows 40 to 45", True)
    assert call(main, "tag", path, "exclude", "--remove") == 0
    assert capsys.readouterr().out.splitlines() == ["whole drive: rows 0 to 49"]
    assert call(main, "tag", path, "exclude", "--remove") == 1
    assert "its tags: whole drive" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "shown"),
    [
        (["good"], "no tag 'good'; its tags: bend, exclude"),
        (["exlude"], "no tag 'exlude'; did you mean exclude?"),
        (["bend", "--rows", "2", "9"], "these rows, but of rows 5 to 5, rows 8 to 9; without rows"),
    ],
    ids=["absent", "misspelt", "other rows"],
)
def test_a_tag_that_is_not_there_is_not_removed(
    flags: list[str], shown: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1] * 50)
    for name, first, last in (("exclude", 1, 2), ("bend", 5, 5), ("bend", 8, 9)):
        assert call(main, "tag", path, name, "--rows", first, last) == 0
    capsys.readouterr()
    assert call(main, "tag", path, *flags, "--remove") == 1
    assert shown in one_line_in(capsys)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (["tag", "LOG", "x", "--start", 100], "no row between 100 s and its end"),
        (["info", "a"], "did you mean a.mcap?"),
        (["trim", "LOG", "--to", "new.mcap", "--rows", 90, 95], "its rows are 0 to 49"),
        (["trim", "LOG", "--to", "LOG"], "exists already"),
        (["split", "LOG"], "a single drive"),
        (["recover", "none.mcap"], "none.mcap: cannot be opened"),
    ],
)
def test_what_cannot_be_done_reports_why(
    tmp_path: Path,
    line: list[object],
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_log(tmp_path / "a.mcap", [0.1] * 50)
    before = path.read_bytes()
    assert call(main, *(path if word == "LOG" else word for word in line)) == 1
    assert message in capsys.readouterr().err
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (["tag", "LOG", "a\nb"], "not a name for a tag"),
        (["tag", "LOG", "x"], "which rows?"),
        (["tag", "LOG", "--rows", 1, 2], "give the name"),
        (["tag", "LOG", "x", "--rows", 1, 2, "--end", 3], "either --rows, or"),
        (["trim", "LOG", "--to", "new", "--end", 3], "new.mcap"),
        (["trim", "LOG", "--to", "new.mcap", "--rows", 5, 3], "--rows 5 3: "),
        (["trim", "LOG", "--to", "new.mcap", "--start", "nan"], "--start nan "),
        (["trim", "LOG", "--to", "new.mcap", "--start", -5], "--start -5 "),
        (["tag", "LOG", "x", "--start", -5], "--start -5 "),
        (["merge", "LOG", "--to", "new.mcap"], "at least 2 logs"),
        (["info"], "at least 1 log"),
    ],
)
def test_flags_that_make_no_sense_are_bad_usage(
    tmp_path: Path,
    line: list[object],
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_log(tmp_path / "a.mcap", [0.1] * 50)
    assert call(main, *(path if word == "LOG" else word for word in line)) == 2
    (reported,) = capsys.readouterr().err.splitlines()
    assert message in reported
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.mcap"]


def test_trim_merge_split_and_recover_write_new_logs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b, c = (tmp_path / name for name in ("a.mcap", "b.mcap", "c.mcap"))
    path = write_log(tmp_path / "a.mcap", [0.01 * row for row in range(50)])
    assert call(main, "tag", a, "exclude", "--rows", 5, 20) == 0
    assert call(main, "trim", a, "--to", b, "--end", 0.95) == 0
    assert "b.mcap: 10 rows, 40 messages" in capsys.readouterr().out
    assert call(main, "merge", a, b, "--to", c) == 0
    assert "c.mcap: 60 rows, 240 messages" in capsys.readouterr().out
    assert call(main, "tag", c) == 0
    assert capsys.readouterr().out == "exclude: rows 5 to 20\nexclude: rows 55 to 59\n"
    assert call(main, "rewrite", a, "--to", tmp_path / "d.mcap") == 0
    assert call(main, "split", c, "--to", tmp_path / "drives") == 0
    reported = capsys.readouterr().out
    for drive in ("c-1.mcap: 50 rows", "c-2.mcap: 10 rows"):
        assert drive in reported
    for name in ("a", "b", "c", "d", "drives/c-1", "drives/c-2"):
        assert is_whole(tmp_path / f"{name}.mcap")
    path.rename(tmp_path / "k.mcap.0a1b2c.part")
    assert call(main, "recover", tmp_path / "k.mcap.0a1b2c.part") == 0
    assert "k.mcap: 50 rows, 200 messages" in capsys.readouterr().out
    assert call(main, "recover", tmp_path / "k.mcap.0a1b2c.part") == 0  # that name is taken now
    assert {log.name for log in tmp_path.glob("k.*mcap")} == {"k.mcap", "k.recovered.mcap"}


def test_a_whole_log_is_not_recovered_but_copied_if_that_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1] * 5)
    assert call(main, "recover", path) == 0
    assert capsys.readouterr().out == f"{path}: complete, nothing to recover; nothing was written\n"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.mcap"]
    assert call(main, "recover", path, "--to", tmp_path / "b.mcap") == 0
    assert "a.mcap: complete, nothing to recover\n" in capsys.readouterr().out
    assert read_messages(tmp_path / "b.mcap").keys() == read_messages(path).keys()


@pytest.mark.parametrize(("damaged", "code"), [("chunk", 3), ("index", 0), ("summary", 0), ("metadata", 0)])
def test_what_is_not_whole_in_every_byte_is_recovered(
    tmp_path: Path, damaged: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1] * 5)
    end, metadata = contents(path).chunks[0].end, path.read_bytes().index(b"toolkit")
    places = {"chunk": end - 1, "index": end + 20, "summary": -60, "metadata": metadata}
    flip_bit(path, places[damaged])
    assert call(main, "recover", path) == code
    assert (tmp_path / "a.recovered.mcap").exists()
    assert "complete, nothing to recover" not in capsys.readouterr().out


def test_a_new_tag_is_said_with_what_may_have_been_meant(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1] * 5)
    reported: list[tuple[str, str]] = [
        ("exclud", "new tag 'exclud'; did you mean exclude?\n"),
        ("recovery", "new tag 'recovery'\n"),
        ("recovery", ""),
        ("exclude", ""),
    ]
    for name, line in reported:
        assert call(main, "tag", path, name, "--rows", 1, 2) == 0
        *lines, advice = capsys.readouterr().err.splitlines(keepends=True)
        assert ("".join(lines), advice[:7]) == (line, "next: `")
    other = write_log(tmp_path / "b.mcap", [0.2] * 5)  # names of the logs beside it are known, too
    assert call(main, "tag", other, "recovery", "--rows", 1, 2) == 0
    assert "new tag" not in capsys.readouterr().err
    assert call(main, "tag", other, "recovry", "--rows", 1, 2) == 0
    assert "did you mean recovery?" in capsys.readouterr().err


@pytest.mark.parametrize("answer", ["y", "n"])
def test_a_terminal_is_asked_back(tmp_path: Path, answer: str) -> None:
    pty = pytest.importorskip("pty")
    path = write_log(tmp_path / "a.mcap", [0.1] * 5)
    ours, theirs = pty.openpty()
    try:
        process = subprocess.Popen(
            command("bc-log", "tag", path, "exclud", "--rows", 1, 2),
            stdin=theirs,
            stdout=subprocess.PIPE,
            stderr=theirs,
            env=environment(),
        )
        shown = b""
        while b"all the same?" not in shown:
            shown += os.read(ours, 1000)
        os.write(ours, answer.encode() + b"\n")
        out, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        os.close(theirs)
        os.close(ours)
    assert (process.returncode, out) == ((0, b"exclud: rows 1 to 2\n") if answer == "y" else (1, b""))


def test_info_of_a_drive_in_which_nothing_was_driven(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, {"source": "drive"}) as writer:
        writer.event(START_NS, "connected")
    assert call(main, "info", path) == 0
    reported = capsys.readouterr().out
    assert "no rows: nothing was driven" in reported
    assert "another program" not in reported


def test_pictures_of_several_sizes_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ok, small = cv2.imencode(".png", np.zeros((60, 80, 3), np.uint8))
    assert ok
    rows: list[tuple[float, float, float, bytes | None]] = [
        (row / 10, 0.1, 0.0, small.tobytes() if row in (3, 4) else jpeg(50)) for row in range(6)
    ]
    path = log_with(tmp_path / "a.mcap", rows)
    reported = "4 pictures of 320x160 (first: row 0), 2 pictures of 80x60 (first: row 3)"
    assert found_in(path) == [("cameras with pictures of several sizes", f"/camera/center: {reported}")]
    trimmed = tmp_path / "b.mcap"
    assert call(main, "trim", path, "--to", trimmed, "--start", 0) == 0
    capsys.readouterr()
    for log in (path, trimmed):
        assert info_of(log, capsys)["picture_sizes"] == {"/camera/center": reported}
        assert call(main, "info", log) == 0
        assert "pictures of several sizes on /camera/center" in capsys.readouterr().out
    assert call(main, "trim", path, "--to", tmp_path / "c.mcap", "--rows", 0, 2) == 0
    capsys.readouterr()
    assert info_of(tmp_path / "c.mcap", capsys)["picture_sizes"] == {}


def test_a_log_without_any_picture_is_found(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1] * 5, cameras=())
    assert found_in(path) == [("stretches of rows without a picture", "/camera/center rows 0 to 4")]


def test_one_log_that_cannot_be_read_does_not_hide_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1] * 5, picture)
    for subcommand in ("check", "info"):
        assert call(main, subcommand, tmp_path / "none.mcap", path, "--json") == 1
        shown = capsys.readouterr()
        assert json.loads(shown.out)["path"] == str(path)
        assert "none.mcap: cannot be opened" in shown.err


def test_merged_drives_have_the_rate_at_which_they_were_driven(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_log(tmp_path / "a.mcap", [0.1] * 21)
    assert call(main, "merge", path, path, "--to", tmp_path / "b.mcap") == 0
    capsys.readouterr()
    reported = info_of(tmp_path / "b.mcap", capsys)
    assert (reported["drives"], reported["driven_s"], reported["duration_s"]) == (2, 4.0, 2.0)
    assert {topic["per_second"] for topic in reported["topics"]} == {42 / 4.0}
    call(main, "info", tmp_path / "b.mcap")
    assert "2.0 to 0.0 s (time goes back)" in capsys.readouterr().out


@pytest.mark.parametrize("stretches", ["[1", '[["gap", 1, 2, NaN, Infinity]]', '[["gap", 1e400, 2, 0, 1]]', "{}"])
def test_info_is_valid_json_whatever_a_log_reports_of_itself(
    tmp_path: Path, stretches: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, {}) as writer:
        writer.event(START_NS, "hello")
        writer.add_metadata("bc.quality", {"drives": "-1", "driven_s": "nan", "gap": "x", "stretches": stretches})
    assert call(main, "info", path, "--json") == 0

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    reported = json.loads(capsys.readouterr().out, parse_constant=refuse)
    assert (reported["stretches"], reported["driven_s"]) == ([], None)


def test_a_long_setting_of_a_log_is_a_few_lines_and_whole_in_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    path = tmp_path / "a.mcap"
    car = json.dumps({"max_steering_deg": 25.0, "bonnet": {"center": [[row, 160] for row in range(200)]}})
    with LogWriter(path, {"source": "simulator", "car": car}) as writer:
        writer.vehicle(START_NS, 0, VehicleState(steering=0.5))
    assert call(main, "info", path) == 0
    lines = capsys.readouterr().out.splitlines()
    first = next(number for number, line in enumerate(lines) if line.startswith("  car: "))
    last = next(number for number, line in enumerate(lines) if line.startswith("  source: "))
    reported = "".join(lines[first:last])
    assert last - first <= 7
    assert '"max_steering_deg": 25.0' in reported
    assert "--json" in reported
    assert call(main, "info", path, "--json") == 0
    assert json.loads(capsys.readouterr().out)["session"]["car"] == car


def test_what_is_no_log_is_reported_with_the_next_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "junk.mcap").write_text("junk")
    assert call(main, "info", tmp_path / "junk.mcap") == 1
    assert "`bc-log ls`" in capsys.readouterr().err
