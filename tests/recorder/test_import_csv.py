"""Any folder of pictures with a csv becomes a log: what is there is kept, and what is what is said by flags."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from common.car import CAMERAS
from recorder import Imported, Log, RecordingError
from recorder.import_cli import main as bc_import
from tests.helpers.imports import import_csv
from tests.helpers.lerobot_logs import jpeg
from tests.helpers.logs import read_messages
from tests.helpers.udacity import call

ANGLES = [0.0, -90.0, 45.0, 180.0]


def folder_of(tmp_path: Path, csv: str, names: Sequence[str] = ()) -> Path:
    folder = tmp_path / "theirs"
    folder.mkdir()
    for row, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(jpeg("center", row))
    (folder / "labels.csv").write_text(csv)
    return folder


def imported(source: Path, *columns: str, **options: Any) -> Imported:
    return import_csv(source, source.parent / "imported.mcap", columns, **options)


def steering_of(log: Path) -> list[float]:
    with Log(log) as opened:
        values: list[float] = opened.vehicle()["steering"].to_pylist()
    return values


def test_one_camera_a_rate_and_a_scale_are_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As a segment of comma2k19 that was unpacked: numbered pictures, and the wheel's angle in degrees."""
    rows = "".join(f"{row},{angle},{12.5}\n" for row, angle in enumerate(ANGLES))
    folder = folder_of(tmp_path, f"frame,angle,speed\n{rows}", [f"frames/{row:06d}.jpg" for row in range(4)])
    flags = ["--columns", "image=frame", "steering=angle", "--rate", 20, "--steering-scale", -0.005]
    assert call(bc_import, folder, "comma", "--sessions", tmp_path / "sessions", *flags) == 0
    assert "4 rows, 4 pictures" in capsys.readouterr().out
    log = tmp_path / "sessions/comma.mcap"
    messages = read_messages(log)
    assert set(messages) == {"/camera/center", "/vehicle"}
    assert [(m.log_time, image.data) for m, image in messages["/camera/center"]] == [
        (50_000_000 * row, jpeg("center", row)) for row in range(4)
    ]
    assert [state.steering for _, state in messages["/vehicle"]] == [-0.005 * angle for angle in ANGLES]
    assert all(math.isnan(state.speed_mph) for _, state in messages["/vehicle"])
    with Log(log) as opened:
        assert opened.metadata["source"] == "csv"
        assert opened.metadata["columns"] == "steering=angle center=frame"
        assert opened.metadata["clock"].startswith("20 Hz")
        assert opened.metadata["start"].startswith("1970")


def test_all_columns(tmp_path: Path) -> None:
    names = [f"{camera}/{row}.jpg" for row in range(2) for camera in CAMERAS]
    csv = (
        "t;c;l;r;s;gas;stop;v\n"
        "1720880000,5;center/0.jpg;left/0.jpg;right/0.jpg;0,25;0,5;;12,5\n"
        "1720880000,6;center\\1.jpg;;right/1.jpg;-1;-0,5;0,1;\n"
    )
    folder = folder_of(tmp_path, csv, names)
    columns = [
        "time_s=t",
        "center=c",
        "left=l",
        "right=r",
        "steering=s",
        "throttle=gas",
        "brake=stop",
        "speed_mph=v",
    ]
    done = imported(folder / "labels.csv", *columns)
    with Log(done.path) as log:
        vehicle = log.vehicle().to_pylist()
        cameras = {camera: log.pictures(f"/camera/{camera}").sequence.tolist() for camera in CAMERAS}
        assert log.metadata["clock"] == "recorded"
    assert cameras == {"center": [0, 1], "left": [0], "right": [0, 1]}
    assert list(vehicle[0].values()) == [0, 1_720_880_000_500_000_000, 0.25, 0.5, 0.0, 12.5]
    assert list(vehicle[1].values())[1:5] == [1_720_880_000_600_000_000, -1.0, 0.0, 0.5]
    assert dict(done.skipped.counts) == {"pictures without a row": 1}


@pytest.mark.parametrize(
    ("column", "time"), [("time_ns", "1" * 5000), ("time_s", "1e305"), ("time_ns", str(2**63)), ("time_ms", "-1")]
)
def test_a_time_that_no_log_can_hold_costs_its_row(tmp_path: Path, column: str, time: str) -> None:
    folder = folder_of(tmp_path, f"p,s,t\na.jpg,0,1\nb.jpg,0,{time}\n", ["a.jpg", "b.jpg"])
    done = imported(folder, "image=p", "steering=s", f"{column}=t")
    assert "rows with a time that no log can hold: 1 (line 3)" in done.skipped.lines()


@pytest.mark.parametrize(
    ("column", "begin", "step", "likely"),
    [
        ("time_s", 0, 100, "milliseconds? `--time-unit ms`"),
        ("time_s", 0, 100_000, "microseconds? `--time-unit us`"),
        ("time_ms", 0, 0.1, "seconds? `--time-unit s`"),
        ("time_s", 1_720_880_000_000, 100, "milliseconds? `--time-unit ms`"),  # since 1970: no log holds them
        ("time_s", 0, 0.1, None),
        ("time_ms", 1_720_880_000_000, 100, None),
        ("time_s", 0, 2, None),  # a slow camera
    ],
)
def test_times_in_another_unit_are_asked_about(
    tmp_path: Path, column: str, begin: int, step: float, likely: str | None
) -> None:
    names = [f"{row}.jpg" for row in range(9)]
    csv = "p,s,t\n" + "".join(f"{name},0,{begin + row * step}\n" for row, name in enumerate(names))
    folder = folder_of(tmp_path, csv, names)
    try:
        printed = " ".join(imported(folder, "image=p", "steering=s", f"{column}=t").questions)
    except RecordingError as error:
        printed = str(error)
    assert likely in printed if likely else printed == ""


def test_of_two_columns_with_one_name_none_is_guessed(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "p,s,s\na.jpg,0.5,0.25\n", ["a.jpg"])
    with pytest.raises(RecordingError, match="several columns 's'; name all by number, from 1"):
        imported(folder, "image=p", "steering=s", rate=10.0)
    assert steering_of(imported(folder, "image=1", "steering=3", rate=10.0).path) == [0.25]


def test_a_csv_without_a_header_has_columns_by_number(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "a.jpg,7,0.5\nb.jpg,7,0.25\n", ["a.jpg", "b.jpg"])
    done = imported(folder, "image=1", "steering=3", rate=10.0)
    assert steering_of(done.path) == [0.5, 0.25]


@pytest.mark.parametrize("separator", [";", "\t"], ids=["semicolon", "tab"])
def test_decimal_commas_as_spreadsheets_write_them(tmp_path: Path, separator: str) -> None:
    """Without a header, the first line may have as many decimal commas as separators."""
    csv = "a.jpg|0,5|0,25\nb.jpg|-0,5|1\n".replace("|", separator)
    folder = folder_of(tmp_path, csv, ["a.jpg", "b.jpg"])
    done = imported(folder, "image=1", "steering=2", "throttle=3", rate=10.0)
    assert (steering_of(done.path), done.skipped.counts) == ([0.5, -0.5], {})


def test_utf_16_as_powershell_writes_it(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "", ["ä.jpg"])
    (folder / "labels.csv").write_text("p,s\r\nä.jpg,0.5\r\n", "utf-16", newline="")
    assert steering_of(imported(folder, "image=p", "steering=s", rate=10.0).path) == [0.5]


def test_rows_that_cannot_be_used_are_named_and_take_their_time(tmp_path: Path) -> None:
    csv = "p,s\na.jpg,0.5\nb.jpg,\nc.jpg,nan\n,0.1\nmissing.jpg,0.1\na.jpg,0.2\n\ncut.jpg,0.1\nd.jpg,2\n"
    folder = folder_of(tmp_path, csv, ["a.jpg", "b.jpg", "c.jpg", "d.jpg", "cut.jpg", "more.jpg"])
    (folder / "cut.jpg").write_bytes(jpeg("left", 1)[:-50])
    done = imported(folder, "image=p", "steering=s", rate=10.0)
    with Log(done.path) as log:
        assert log.vehicle()["log_time_ns"].to_pylist() == [0, 700_000_000]
        assert log.vehicle()["steering"].to_pylist() == [0.5, 2.0]
    assert {reason.partition(" (")[0]: count for reason, count in done.skipped.counts.items()} == {
        "rows whose steering is not a finite number": 2,
        "rows that name no picture": 1,
        "pictures that a row names and no file has, or several have": 1,
        "rows with the pictures of an earlier row": 1,
        "pictures that are not whole JPEG or PNG files": 1,
        "rows with steering beyond -1..1": 1,
        "pictures without a row": 1,
    }


def test_a_name_that_two_folders_have_is_none_and_links_are_not_followed(tmp_path: Path) -> None:
    csv = "p,s\nx.jpg,0\none/x.jpg,0.1\nout.jpg,0.2\n../secret.jpg,0.3\n"
    (tmp_path / "secret.jpg").write_bytes(jpeg("right", 5))
    folder = folder_of(tmp_path, csv, ["one/x.jpg", "two/x.jpg"])
    (folder / "out.jpg").symlink_to(tmp_path / "secret.jpg")
    done = imported(folder, "image=p", "steering=s", rate=10.0)
    assert steering_of(done.path) == [0.1]


@pytest.mark.parametrize(
    ("columns", "rate_hz", "why"),
    [
        (["image=p"], 10.0, "give at least image=COLUMN and steering=COLUMN"),
        (["image=p", "steering=s"], None, "its rows have no times: give --rate ROWS_A_SECOND"),
        (["image=p", "steering=s", "time_s=s"], 10.0, "its rows have their times"),
        (["image=p", "stering=s"], 10.0, "--columns stering=s: expected WHAT=COLUMN.* did you mean steering?"),
        (["image=p", "steering"], 10.0, "--columns steering: expected WHAT=COLUMN"),
        (["image=p", "center=p", "steering=s"], 10.0, "image and center are the same"),
        (
            ["image=p", "steering=angel"],
            10.0,
            r"no column 'angel'; the first line names p, s, angle. did you mean angle\?",
        ),
        (["image=p", "steering=4"], 10.0, "no column '4'"),
    ],
)
def test_what_does_not_say_it_is_one_line(
    tmp_path: Path, columns: list[str], rate_hz: float | None, why: str
) -> None:
    folder = folder_of(tmp_path, "p,s,angle\na.jpg,0,0\n", ["a.jpg"])
    with pytest.raises(RecordingError, match=why) as raised:
        imported(folder, *columns, rate=rate_hz)
    assert "\n" not in str(raised.value)


def test_folders_that_have_no_csv_several_or_no_pictures_are_one_line(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "p,s\na.jpg,0\n")
    with pytest.raises(RecordingError, match=r"no \.jpg, \.jpeg or \.png in it"):
        imported(folder, "image=p", "steering=s", rate=10.0)
    (folder / "a.jpg").write_bytes(jpeg("center", 0))
    (folder / "labels.csv").write_text("p,s\n" + "x" * 200_000)
    with pytest.raises(RecordingError, match=r"not a csv .a line of over 100,000 characters"):
        imported(folder, "image=p", "steering=s", rate=10.0)
    (folder / "more.csv").write_text("")
    with pytest.raises(RecordingError, match=r"which csv\? .* labels.csv, more.csv"):
        imported(folder, "image=p", "steering=s", rate=10.0)
    assert not (tmp_path / "imported.mcap").exists()


def test_a_folder_with_a_csv_asks_for_its_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = folder_of(tmp_path, "p,s\na.jpg,0\n", ["a.jpg"])
    assert call(bc_import, folder, "mine", "--sessions", tmp_path) == 1
    assert "--columns image=COLUMN steering=COLUMN" in capsys.readouterr().err
