"""A folder in the layout of Udacity's simulator that another one wrote: one camera, pictures without times."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from recorder import Imported, Log, LogWriter, RecordingError, import_udacity
from recorder.import_cli import main
from recorder.sources.import_recording import import_recording
from recorder.sources.settings import ImportSettings
from recorder.sources.udacity_follow import watch_udacity
from tests.helpers.driving import one_line_in
from tests.helpers.logs import read_messages
from tests.helpers.tubs import record_1, write_tub_1
from tests.helpers.udacity import call, jpeg, make_recording, paths

Record = Callable[..., Imported]
ROWS = "".join(f"IMG/{number}.jpg,,,0.{number},0.5,0,{20 + number}.5\n" for number in range(1, 5))


def make_folder(folder: Path, csv: str = ROWS) -> list[bytes]:
    """Pictures 1.jpg to 4.jpg and the csv; the pictures' bytes."""
    make_recording(folder, csv, [])
    pictures = [jpeg(50 * number, number) for number in range(1, 5)]
    for number, picture in enumerate(pictures, start=1):
        (folder / "IMG" / f"{number}.jpg").write_bytes(picture)
    return pictures


def watched(folder: Path, log: Path, rate_hz: float | None) -> Imported:
    return watch_udacity(folder, log, rate_hz=rate_hz, idle_s=0)


def imported(folder: Path, log: Path, rate_hz: float | None) -> Imported:
    return import_udacity(folder, log, rate_hz=rate_hz)


def metadata_of(path: Path) -> dict[str, str]:
    with Log(path) as log:
        return log.metadata


both_ways = pytest.mark.parametrize("record", [imported, watched])


@both_ways
def test_one_camera_and_no_times(tmp_path: Path, record: Record) -> None:
    pictures = make_folder(tmp_path / "torcs")
    done = record(tmp_path / "torcs", tmp_path / "torcs.mcap", 20)
    assert (done.rows, done.pictures, len(done.skipped)) == (4, 4, 0)
    messages = read_messages(done.path)
    assert messages.keys() == {"/camera/center", "/vehicle"}
    times = [0, 50_000_000, 100_000_000, 150_000_000]
    assert [message.log_time for message, _ in messages["/camera/center"]] == times
    states = [(message.log_time, state.steering) for message, state in messages["/vehicle"]]
    assert states == list(zip(times, [0.1, 0.2, 0.3, 0.4], strict=True))
    assert [image.data for _, image in messages["/camera/center"]] == pictures
    about = metadata_of(done.path)
    assert about["clock"].startswith("20 Hz, as --rate said")
    assert about["start"].startswith("1970")


@both_ways
def test_a_row_that_cannot_be_used_leaves_its_time_free(tmp_path: Path, record: Record) -> None:
    make_folder(tmp_path / "torcs", f"center,left,right,steering\n{ROWS.replace('0.2,', 'x,', 1)}")
    done = record(tmp_path / "torcs", tmp_path / "torcs.mcap", 10)
    assert done.skipped.counts == {"rows with a value that is not a number": 1}
    assert [m.log_time for m, _ in read_messages(done.path)["/vehicle"]] == [0, 200_000_000, 300_000_000]


@both_ways
@pytest.mark.parametrize("row", ["{},,", "{},{},", ",{},{}", '{}, "" , ""', "{} , ,{}"])
def test_cameras_that_a_row_leaves_out_are_not_missed(tmp_path: Path, record: Record, row: str) -> None:
    """But the centre is always named: it is what the network drives by."""
    center, left, _ = paths(0).split(",")
    make_recording(tmp_path / "drive", f"{paths(1)},0,1,0,9.5\n{row.format(center, left)},0,1,0,9.5\n", [0, 1])
    done = record(tmp_path / "drive", tmp_path / "log.mcap", None)
    reasons = {reason for reason, _ in done.skipped} - {"pictures without a row"}
    if row.startswith(","):
        assert (done.rows, reasons) == (1, {"rows with fewer than three columns of pictures, or cut off"})
    else:
        assert (done.rows, done.pictures, reasons) == (2, 3 + row.count("{}"), set())


def test_pictures_without_times_name_the_flag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    make_folder(tmp_path / "torcs")
    assert call(main, tmp_path / "torcs", "torcs") == 1
    assert "its rows have no times: give --rate ROWS_A_SECOND, such as 20" in one_line_in(capsys)
    assert call(main, tmp_path / "torcs", "torcs", "--rate", 20) == 0
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-1] == "next: `bc-index`"
    assert "torcs.mcap: 4 rows, 4 pictures" in printed.out


@both_ways
def test_a_rate_for_pictures_that_show_their_times_is_refused(tmp_path: Path, record: Record) -> None:
    make_recording(tmp_path / "drive", f"{paths(0)},0,1,0,9.5\n", [0])
    with pytest.raises(RecordingError, match=r"--rate: .*leave it out"):
        record(tmp_path / "drive", tmp_path / "log.mcap", 20)
    tub = write_tub_1(tmp_path / "tub", {number: record_1(number) for number in range(4)})
    with pytest.raises(RecordingError, match=r"--rate: .*leave it out"):
        import_recording(tub, tmp_path / "log.mcap", ImportSettings(rate=20))
    assert not (tmp_path / "log.mcap").exists()


def test_a_tub_without_times_at_another_rate(tmp_path: Path) -> None:
    records = {number: record_1(number) for number in range(4)}
    for values in records.values():
        del values["milliseconds"]
    done = import_recording(
        write_tub_1(tmp_path / "tub", records, start_s=None), tmp_path / "log.mcap", ImportSettings(rate=10)
    )
    assert [message.log_time for message, _ in read_messages(done.path)["/vehicle"]] == [
        number * 100_000_000 for number in range(4)
    ]
    assert metadata_of(done.path)["clock"].startswith("10 Hz, as --rate said")


# Pictures of different sizes


def picture_of(width: int, height: int) -> bytes:
    return bytes(cv2.imencode(".jpg", np.zeros((height, width, 3), np.uint8))[1])


@both_ways
def test_pictures_of_different_sizes_are_reported_at_import(tmp_path: Path, record: Record) -> None:
    folder = tmp_path / "torcs"
    make_folder(folder)
    assert record(folder, tmp_path / "one.mcap", 20).notices == []
    (folder / "IMG" / "2.jpg").write_bytes(picture_of(640, 480))
    (folder / "IMG" / "3.jpg").write_bytes(picture_of(640, 480))
    (notice,) = record(folder, tmp_path / "two.mcap", 20).notices
    assert notice == (
        "pictures of different sizes on /camera/center: 2 pictures of 320x160 (first: row 0),"
        " 2 pictures of 640x480 (first: row 1)"
    )


def test_cameras_of_different_sizes_are_reported(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", {"source": "simulator"}) as writer:
        for row in range(2):
            writer.picture("center", row, row, picture_of(320, 160))
            writer.picture("left", row, row, picture_of(640, 480))
        assert writer.notices == [
            "pictures of different sizes: 320x160 on /camera/center, 640x480 on /camera/left;"
            " they should show the same part of the world"
        ]
