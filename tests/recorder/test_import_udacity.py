"""A Udacity recording becomes a log, whatever machine, locale and accident it comes from."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from common.car import CAMERAS
from recorder import Imported, RecordingError, import_udacity
from recorder.cli import main as bc_record
from recorder.import_cli import main
from recorder.sources.import_recording import import_recording
from tests.helpers.driving import one_line_in
from tests.helpers.logs import read_messages
from tests.helpers.udacity import call, jpeg, make_recording, paths, picture_name

START_NS = int(datetime(2024, 7, 13, 14, 30, 16, tzinfo=UTC).timestamp()) * 1_000_000_000
VALUES = [(0.0, 1.0, 0.0, 7.8e-05), (-0.35, 0.25, 0.0, 12.1822), (0.05, 0.0, 1.0, 30.19)]
CELLS = ["0,1,0,7.8E-05", "-0.35,0.25,0,12.1822", "0.05,0,1,30.19"]


def three_rows(prefix: str = "IMG/", end: str = "\n") -> str:
    return "".join(f"{paths(number, prefix)},{cells}{end}" for number, cells in enumerate(CELLS))


def values_of(log: Path) -> list[tuple[float, float, float, float]]:
    states = [state for _, state in read_messages(log)["/vehicle"]]
    return [(state.steering, state.throttle, state.brake, state.speed_mph) for state in states]


def pictures_of(log: Path) -> dict[str, bytes]:
    """The pictures in a log, by the name that they had in the recording."""
    return {
        picture_name(camera, (message.log_time - START_NS) // 100_000_000): image.data
        for camera in CAMERAS
        for message, image in read_messages(log).get(f"/camera/{camera}", [])
    }


def imported(folder: Path) -> Imported:
    return import_udacity(folder, folder / "imported.mcap")


def assert_all_three_rows(folder: Path, pictures: dict[str, bytes]) -> None:
    done = imported(folder)
    assert (done.rows, done.pictures, list(done.skipped)) == (3, 9, [])
    assert values_of(done.path) == VALUES
    assert pictures_of(done.path) == pictures


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"], ids=["LF", "CRLF", "CR only"])
def test_line_ends_and_no_final_one(tmp_path: Path, end: str) -> None:
    assert_all_three_rows(tmp_path, make_recording(tmp_path, three_rows(end=end).removesuffix(end)))


@pytest.mark.parametrize("separator", [";", "\t", " ; "], ids=["semicolon", "tab", "spaces"])
def test_a_csv_that_a_spreadsheet_has_saved(tmp_path: Path, separator: str) -> None:
    """In countries with decimal commas, Excel separates with semicolons."""
    header = "center,left,right,steering,throttle,brake,speed".replace(",", separator)
    rows = [
        separator.join([paths(number, "C:\\a, b\\", separator), *cells.replace(".", "|").split(",")])
        for number, cells in enumerate(CELLS)
    ]
    csv = "\n".join([header, *rows]).replace("|", ",")
    assert_all_three_rows(tmp_path, make_recording(tmp_path, csv))


def test_semicolons_with_one_camera(tmp_path: Path) -> None:
    make_recording(tmp_path, f"{picture_name('center', 0)};;;-0,5;0;1;3,25;;\n", [0])
    assert values_of(imported(tmp_path).path) == [(-0.5, 0.0, 1.0, 3.25)]


@pytest.mark.parametrize(
    "prefix",
    [
        "D:\\IMG/",
        "C:\\Usuários\\José\\área de trabalho\\IMG\\",
        "/data/laps 1, 2 and 3/IMG/",
        "../IMG/",
        "",
    ],
)
def test_only_the_file_name_of_a_path_counts(tmp_path: Path, prefix: str) -> None:
    assert_all_three_rows(tmp_path, make_recording(tmp_path, three_rows(prefix)))


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8-sig", "mac_roman"])
def test_accents_in_the_encoding_of_another_machine(tmp_path: Path, encoding: str) -> None:
    csv = three_rows("/Users/José/Anna’s drives/IMG/").encode(encoding)
    assert_all_three_rows(tmp_path, make_recording(tmp_path, csv))


def test_utf_16_as_powershell_writes_it(tmp_path: Path) -> None:
    assert_all_three_rows(tmp_path, make_recording(tmp_path, three_rows().encode("utf-16")))


@pytest.mark.parametrize("img", ["IMG", ".", "../IMG"])
def test_pictures_are_found_beside_the_csv_and_above_it(tmp_path: Path, img: str) -> None:
    folder = tmp_path / "drive"
    folder.mkdir()
    assert_all_three_rows(folder, make_recording(folder, three_rows("/elsewhere/IMG/"), img=img))


@pytest.mark.parametrize("title", ["center,left,right,", "center, left, right, ", '"center","left","right",'])
def test_a_header_is_no_row(tmp_path: Path, title: str) -> None:
    csv = f"{title}steering,throttle,brake,speed\n{three_rows()}"
    assert_all_three_rows(tmp_path, make_recording(tmp_path, csv))


@pytest.mark.parametrize(
    "header",
    ["left,center,right,steering,throttle,brake,speed", "center,left,right,throttle,steering,reverse,speed"],
)
def test_columns_in_another_order_are_refused(tmp_path: Path, header: str) -> None:
    """They would be read as others: the left picture as the centre's, the throttle as steering."""
    make_recording(tmp_path, f"{header}\n{three_rows()}")
    with pytest.raises(RecordingError, match="expected the order center, left, right, steering, throttle"):
        imported(tmp_path)


@pytest.mark.parametrize("separator", [", ", ","], ids=["comma and space", "comma"])
@pytest.mark.parametrize(
    ("cells", "values"),
    [
        ("-0,08581576|0,1286689|0|12,1822", (-0.08581576, 0.1286689, 0.0, 12.1822)),
        ("-0,5|0,25|0,125|3,75", (-0.5, 0.25, 0.125, 3.75)),
        ("0|0|0|0,5", (0.0, 0.0, 0.0, 0.5)),
        ("1|1|0|9", (1.0, 1.0, 0.0, 9.0)),
        ("0|0|1|15,5", (0.0, 0.0, 1.0, 15.5)),
        ("0|1|0|7,8E-05", (0.0, 1.0, 0.0, 7.8e-05)),
    ],
)
def test_decimal_commas(tmp_path: Path, separator: str, cells: str, values: tuple[float, ...]) -> None:
    make_recording(tmp_path, paths(0) + separator + cells.replace("|", separator) + "\n", [0])
    assert values_of(imported(tmp_path).path) == [values]


def test_a_space_shows_a_separator_from_a_decimal_comma(tmp_path: Path) -> None:
    """Without the spaces these cells could as well be a speed of 5.31 mph."""
    make_recording(tmp_path, f"{paths(0, separator=', ')}, 0, 1, 0,5, 31\n", [0])
    assert values_of(imported(tmp_path).path) == [(0.0, 1.0, 0.5, 31.0)]


@pytest.mark.parametrize(
    ("cells", "values"),
    [
        # as Mono's string.Format("{0}") writes -0.2167, 10.9014 and 7.8E-05 for fa-IR
        ("-0/2167,1,0,10/9014", (-0.2167, 1.0, 0.0, 10.9014)),
        ("0,0/5,1,7/8E-05", (0.0, 0.5, 1.0, 7.8e-05)),
        # as ToString("N4") does for ar-SA and fa-IR
        ("0.2167-,0.5000,0.0000,10.9014", (-0.2167, 0.5, 0.0, 10.9014)),
        ("0/2167-,0/5000,0/0000,10/9014", (-0.2167, 0.5, 0.0, 10.9014)),
        # with ICU: fa-IR, ar-EG, sv-SE
        ("\u200e\u22120\u066b2167,1,0,10\u066b9014", (-0.2167, 1.0, 0.0, 10.9014)),
        ("\u061c-0\u066b2167,1,0,7\u066b8E\u061c-05", (-0.2167, 1.0, 0.0, 7.8e-05)),
        ("\u22120,2167,1,0,10,9014", (-0.2167, 1.0, 0.0, 10.9014)),
        ("+0.5,+1,0,.5", (0.5, 1.0, 0.0, 0.5)),
        ('"-0,2167","1","0","10,9014"', (-0.2167, 1.0, 0.0, 10.9014)),
        ('"-0.2167", "1", "0", "10.9014"', (-0.2167, 1.0, 0.0, 10.9014)),
    ],
)
def test_numbers_of_other_countries(tmp_path: Path, cells: str, values: tuple[float, ...]) -> None:
    make_recording(tmp_path, f"{paths(0)},{cells}\n", [0])
    assert values_of(imported(tmp_path).path) == [values]


@pytest.mark.parametrize(
    "cells", ["0.1,0.2,0,20.5,7", "0,1,0,30.5,", "0, 1, 0, 30, 7", '"0,1","0,2","0","20,5","7"', "0,1,0,30,7"]
)
def test_a_row_with_a_value_too_many_is_named(tmp_path: Path, cells: str) -> None:
    make_recording(tmp_path, f"{paths(0)},{CELLS[0]}\n{paths(1)},{cells}\n{paths(2)},{CELLS[2]}\n")
    done = imported(tmp_path)
    if cells.endswith(","):  # an empty cell is no value
        assert (done.rows, len(done.skipped)) == (3, 0)
    else:
        assert values_of(done.path) == [VALUES[0], VALUES[2]]
        assert done.skipped.counts == {"rows with more than four values": 1}


def test_missing_pictures_are_named_and_everything_else_is_kept(tmp_path: Path) -> None:
    pictures = make_recording(tmp_path, three_rows())
    missing = [
        picture_name("left", 1),
        picture_name("center", 2),
        picture_name("left", 2),
        picture_name("right", 2),
    ]
    for name in missing:
        (tmp_path / "IMG" / name).unlink()
    done = imported(tmp_path)
    assert [name for _, name in done.skipped] == [missing[0], *missing[1:]]
    assert (done.rows, done.pictures) == (3, 5)
    assert values_of(done.path) == VALUES
    assert pictures_of(done.path) == {name: data for name, data in pictures.items() if name not in missing}


def test_a_camera_without_any_picture(tmp_path: Path) -> None:
    make_recording(tmp_path, three_rows())
    for number in range(3):
        (tmp_path / "IMG" / picture_name("right", number)).unlink()
    done = imported(tmp_path)
    assert (done.rows, done.pictures, len(done.skipped)) == (3, 6, 3)
    assert "/camera/right" not in read_messages(done.path)


def test_pictures_without_a_row_are_named(tmp_path: Path) -> None:
    make_recording(tmp_path, three_rows(), [0, 1, 2, 7])
    done = imported(tmp_path)
    reason, names = "pictures without a row", [picture_name(camera, 7) for camera in CAMERAS]
    assert list(done.skipped) == [(reason, name) for name in names]
    assert (done.rows, done.pictures) == (3, 9)
    events = [event.message for _, event in read_messages(done.path)["/events"]]
    assert events == [f"skipped {reason}: {name}" for name in names]


@pytest.mark.parametrize("kept", [20, 120, -18, -12])
def test_a_last_row_that_is_cut_off_is_named(tmp_path: Path, kept: int) -> None:
    last = f"{paths(2)},0.05,0.5,1,30.19"
    make_recording(tmp_path, f"{paths(0)},{CELLS[0]}\n{paths(1)},{CELLS[1]}\n{last[:kept]}", [0, 1])
    done = imported(tmp_path)
    assert values_of(done.path) == VALUES[:2]
    assert [name for _, name in done.skipped] == ["line 3"]


@pytest.mark.parametrize(
    "cells",
    [
        *["nan,0,0,1", "0,1e999,0,1", "left,0,0,1", "0,0,0", ""],
        # Python's float() takes these
        *["1_0,0,0,1", "\u0663,0,0,1", "infinity,0,0,1"],
        *["0x1,0,0,1", "0.1\0,0,0,1", "--1,0,0,1", "-1-,0,0,1", "1/2/2024,0,0,1", ".,0,0,1"],
    ],
)
def test_a_row_without_four_numbers_is_named_and_the_others_are_kept(tmp_path: Path, cells: str) -> None:
    make_recording(tmp_path, f"{paths(0)},{CELLS[0]}\n{paths(1)},{cells}\n{paths(2)},{CELLS[2]}\n")
    done = imported(tmp_path)
    assert values_of(done.path) == [VALUES[0], VALUES[2]]
    assert [name for _, name in done.skipped] == ["line 2"]


@pytest.mark.parametrize(
    "data",
    [b"", b"GIF89a not a JPEG", jpeg(90)[:-300], b"\xff\xd8\xff" + bytes(500) + b"\xff\xd9"],
    ids=["empty", "another format", "cut off", "begin and end only"],
)
def test_a_picture_that_is_not_a_whole_jpeg_is_left_out_and_named(tmp_path: Path, data: bytes) -> None:
    pictures = make_recording(tmp_path, three_rows())
    broken = picture_name("center", 1)
    (tmp_path / "IMG" / broken).write_bytes(data)
    done = imported(tmp_path)
    assert [name for _, name in done.skipped] == [broken]
    del pictures[broken]
    assert pictures_of(done.path) == pictures
    assert values_of(done.path) == VALUES


def test_a_csv_of_another_name_or_with_other_columns_reports_what_to_do(tmp_path: Path) -> None:
    make_recording(tmp_path, f"{paths(0)},0.1\n")
    with pytest.raises(RecordingError, match=r"fewer than four values.* name them with --columns"):
        imported(tmp_path)
    (tmp_path / "driving_log.csv").rename(tmp_path / "driving_log (1).csv")
    with pytest.raises(RecordingError, match=r"--columns image=COLUMN .* name it driving_log\.csv"):
        import_recording(tmp_path, tmp_path / "imported.mcap")


def test_without_any_whole_picture_no_log_is_written(tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    for name in make_recording(folder, three_rows()):
        (folder / "IMG" / name).write_bytes(b"")
    with pytest.raises(RecordingError, match=r"^recording: no picture of it can be used; pictures .*: 9 \(center"):
        imported(folder)
    assert sorted(tmp_path.glob("**/*.mcap*")) == []


def test_a_link_that_leaves_the_recording_is_not_followed(tmp_path: Path) -> None:
    secret = tmp_path / "private.jpg"
    secret.write_bytes(jpeg(250))
    folder = tmp_path / "downloaded"
    make_recording(folder, three_rows())
    link = folder / "IMG" / picture_name("left", 0)
    link.unlink()
    link.symlink_to(secret)
    done = imported(folder)
    assert link.name in [name for _, name in done.skipped]
    assert done.pictures == 8
    assert secret.read_bytes() not in done.path.read_bytes()


def pictures_elsewhere(folder: Path, place: Path) -> dict[str, bytes]:
    """A recording whose `place` is a link to a folder on another disk, which has the pictures."""
    pictures = make_recording(folder, three_rows())
    disk = folder.parent / "disk" / "pictures of July"
    disk.parent.mkdir()
    (folder / "IMG").rename(disk)
    place.symlink_to(disk)
    return pictures


@pytest.mark.parametrize("place", ["IMG", "../IMG"])
def test_a_folder_of_pictures_that_is_a_link_is_followed(tmp_path: Path, place: str) -> None:
    folder = tmp_path / "drive"
    pictures = pictures_elsewhere(folder, folder / place)
    assert_all_three_rows(folder, pictures)


def test_a_csv_that_is_a_link_out_of_the_recording_is_not_followed(tmp_path: Path) -> None:
    make_recording(tmp_path / "private", three_rows())
    folder = tmp_path / "downloaded"
    make_recording(folder, "")
    (folder / "driving_log.csv").unlink()
    (folder / "driving_log.csv").symlink_to(tmp_path / "private" / "driving_log.csv")
    with pytest.raises(RecordingError, match="a link out of the recording"):
        imported(folder)


def test_the_same_recording_gives_the_same_bytes(tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    make_recording(folder, three_rows())
    logs = [import_udacity(folder, tmp_path / name).path.read_bytes() for name in ("one.mcap", "two.mcap")]
    assert logs[0] == logs[1]


# The command


def test_bc_record_shows_what_it_wrote(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    make_recording(tmp_path / "drive", three_rows())
    assert call(main, "drive", "lake") == 0
    output = capsys.readouterr()
    assert "sessions/lake.mcap: 3 rows, 9 pictures" in output.out
    assert output.err.splitlines() == [
        "drive: recording of Udacity's simulator, 3 rows, 10 a second, steering -0.35 to 0.05, most often -0.35",
        "next: `bc-index`",
    ]
    assert values_of(tmp_path / "sessions" / "lake.mcap") == VALUES
    make_recording(tmp_path / "short", f"{paths(0)},{CELLS[0]}\n", [0])
    assert call(main, "short", "short") == 0
    assert "short.mcap: 1 row, 3 pictures" in capsys.readouterr().out


def test_bc_record_ends_with_3_and_names_what_was_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_recording(tmp_path / "drive", three_rows(), [0, 1])
    assert call(main, tmp_path / "drive", "lake", "--sessions", tmp_path / "sessions") == 3
    output = capsys.readouterr()
    assert "3 rows, 6 pictures" in output.out
    assert all(picture_name(camera, 2) in output.err for camera in CAMERAS)


def without_csv(folder: Path) -> None:
    make_recording(folder, three_rows())
    (folder / "driving_log.csv").unlink()


HEADER = "center,left,right,steering,throttle,brake,speed\n"


@pytest.mark.parametrize(
    "make",
    [
        Path.mkdir,
        without_csv,
        lambda folder: make_recording(folder, f"{HEADER}{paths(0)},a,b\n"),
        lambda folder: make_recording(folder, three_rows(), []),
        lambda folder: None,
    ],
    ids=["empty", "no csv", "no usable row", "no pictures", "not there"],
)
def test_a_recording_without_anything_usable_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], make: Callable[[Path], object]
) -> None:
    folder = tmp_path / "drive"
    make(folder)
    assert call(main, folder, "lake", "--sessions", tmp_path / "sessions") == 1
    output = capsys.readouterr()
    assert output.out == ""
    error, *_ = output.err.splitlines()[-1:]
    assert error.startswith("bc-import: ")
    assert str(folder) in error
    assert not (tmp_path / "sessions").exists() or not list((tmp_path / "sessions").iterdir())


def test_an_existing_session_is_replaced_only_with_force(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_recording(tmp_path / "drive", three_rows())
    log = tmp_path / "lake.mcap"
    log.write_bytes(b"somebody's work")
    line = [tmp_path / "drive", "lake", "--sessions", tmp_path]
    assert call(main, *line) == 1
    assert "--force" in capsys.readouterr().err
    assert log.read_bytes() == b"somebody's work"
    assert call(main, *line, "--force") == 0
    assert values_of(log) == VALUES
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive", "lake.mcap"]


@pytest.mark.parametrize("name", ["../x", "a/b", "", "..", ".hidden", "-x", "a\\b", "a:b", "a\x1b[2Jb", "a\udc80"])
def test_a_name_that_no_index_can_hold_is_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    for command, *before in ((bc_record,), (main, tmp_path)):
        assert call(command, "--sessions", tmp_path / "sessions", "--", *before, name) == 2
        assert "not a name for a session" in one_line_in(capsys)
    assert list(tmp_path.iterdir()) == []


def test_a_row_that_comes_twice_is_taken_once(tmp_path: Path) -> None:
    """Twice in a log, a picture could be on both sides of the split."""
    make_recording(tmp_path, three_rows() + three_rows())
    done = imported(tmp_path)
    assert values_of(done.path) == VALUES
    assert done.skipped.counts == {"rows with the pictures of an earlier row": 3}


@pytest.mark.parametrize("year", ["1960", "2300"])
def test_a_time_that_no_log_can_hold_costs_the_row(tmp_path: Path, year: str) -> None:
    names = ",".join(f"IMG/{camera}_{year}_01_01_00_00_00_000.jpg" for camera in CAMERAS)
    make_recording(tmp_path, f"{three_rows()}{names},0,0,0,1\n")
    done = imported(tmp_path)
    assert (done.rows, done.skipped.counts) == (
        3,
        {"rows with a time in their pictures' names that no log can hold": 1},
    )
