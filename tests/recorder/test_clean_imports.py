"""What an import tolerates and asks holds for every format: the same rows are written as each of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Final

import pytest

from recorder import Imported, RecordingError
from recorder.sources.import_recording import import_recording
from recorder.sources.settings import ImportSettings
from tests.helpers.logs import read_messages
from tests.helpers.recorded_formats import COLUMNS, FORMATS, Row, as_csv, as_mcap, as_udacity
from tests.helpers.udacity import jpeg, paths

ALL: Final = tuple(FORMATS)
TIMED: Final = ALL[:-1]  # LeRobot's episodes have frames, and their times
TOLERATED: Final = {
    "bytes after a JPEG's end": ALL,
    "damaged pictures are left out": ALL,
    "steering with a scale and an offset": ALL,
    "asks for the middle of the steering": ALL,
    "asks for the scale of the steering": ALL,
    "rows out of order": TIMED,
    "several drives, the later one first": TIMED,
    "asks for the unit of the times": ("csv", "MCAP"),
    "names with other case, slashes, folders": ("Udacity", "csv"),
}
"""What docs/importing.md shows, and the formats that have it. Each is a test here."""


def in_formats(tolerated: str) -> pytest.MarkDecorator:
    names = TOLERATED[tolerated]
    return pytest.mark.parametrize("made_as", [FORMATS[name] for name in names], ids=names)


Make = Callable[..., tuple[Path, ImportSettings]]

ROWS: list[Row] = [(number / 20, (number - 6) / 10, jpeg(60 + number, number + 1)) for number in range(12)]


def imported(made: tuple[Path, ImportSettings], **changes: object) -> Imported:
    source, settings = made
    log = source.parent / "imported.mcap"
    return import_recording(source, log, replace(settings, **changes), overwrite=True)  # type: ignore[arg-type]


def steering_of(done: Imported) -> list[float]:
    return [round(state.steering, 6) for _, state in read_messages(done.path)["/vehicle"]]


def pictures_of(done: Imported) -> list[bytes]:
    return [picture.data for _, picture in read_messages(done.path)["/camera/center"]]


def steps_s_of(done: Imported) -> set[float]:
    times = [message.log_time for message, _ in read_messages(done.path)["/vehicle"]]
    return {round((after - before) / 1e9, 6) for before, after in pairwise(times)}


@pytest.mark.parametrize("made_as", list(FORMATS.values()), ids=ALL)
def test_the_rows_come_as_they_are(tmp_path: Path, made_as: Make) -> None:
    done = imported(made_as(tmp_path / "a", ROWS))
    assert (done.rows, done.pictures, list(done.skipped), steps_s_of(done)) == (12, 12, [], {0.05})
    assert steering_of(done) == [steering for _, steering, _ in ROWS]
    assert pictures_of(done) == [picture for _, _, picture in ROWS]
    assert done.questions == []


@in_formats("bytes after a JPEG's end")
def test_bytes_behind_the_end_of_a_jpeg_do_not_matter(tmp_path: Path, made_as: Make) -> None:
    """A camera that hands out its buffer leaves zeros, or pieces of older pictures."""
    rows = [(time_s, steering, picture + bytes(700) + b"\xff\xd8old") for time_s, steering, picture in ROWS]
    done = imported(made_as(tmp_path / "a", rows))
    assert (done.pictures, list(done.skipped)) == (12, [])


@in_formats("damaged pictures are left out")
def test_a_picture_that_is_cut_off_costs_its_row_or_its_picture(tmp_path: Path, made_as: Make) -> None:
    rows = [*ROWS[:4], (ROWS[4][0], ROWS[4][1], ROWS[4][2][:-300]), *ROWS[5:]]
    done = imported(made_as(tmp_path / "a", rows))
    assert done.pictures == 11
    assert done.skipped.counts == {"pictures that are not whole JPEG or PNG files": 1}


@in_formats("steering with a scale and an offset")
def test_a_steering_with_an_offset_and_a_scale(tmp_path: Path, made_as: Make) -> None:
    """Pulses of 1000 to 2000 us, 1500 is straight on."""
    rows = [(time_s, 1500 + 500 * steering, picture) for time_s, steering, picture in ROWS]
    asked = imported(made_as(tmp_path / "a", rows))
    assert any("--steering-offset" in notice for notice in asked.questions)
    done = imported(made_as(tmp_path / "b", rows), steering_offset=-1500.0, steering_scale=0.002)
    assert steering_of(done) == pytest.approx([steering for _, steering, _ in ROWS], abs=1e-4)
    assert done.questions == []


@in_formats("asks for the middle of the steering")
def test_a_middle_that_is_not_zero_is_asked_about_and_the_flag_mends_it(tmp_path: Path, made_as: Make) -> None:
    steering = [0.53, 0.53, 0.53, 0.15, 0.3, 0.53, 0.85, 0.7, 0.53, 0.53, 0.4, 0.53]
    rows = [(time_s, value, picture) for (time_s, _, picture), value in zip(ROWS, steering, strict=True)]
    asked = imported(made_as(tmp_path / "a", rows))
    text = "steering lies between 0.15 and 0.85: `--steering-offset -0.53`, if 0.53 is straight on?"
    assert text in asked.questions
    done = imported(made_as(tmp_path / "b", rows), steering_offset=-0.53)
    assert steering_of(done) == pytest.approx([value - 0.53 for value in steering], abs=1e-6)
    assert done.questions == []


@in_formats("asks for the scale of the steering")
def test_steering_in_degrees_is_asked_about_and_the_flag_mends_it(tmp_path: Path, made_as: Make) -> None:
    rows = [(time_s, 40 * steering, picture) for time_s, steering, picture in ROWS]
    asked = imported(made_as(tmp_path / "a", rows))
    assert "steering lies between -24 and 20: `--steering-scale 0.04`, if 0 is straight on?" in asked.questions
    done = imported(made_as(tmp_path / "b", rows), steering_scale=0.025)
    assert steering_of(done) == pytest.approx([steering for _, steering, _ in ROWS], abs=1e-6)


@in_formats("rows out of order")
@pytest.mark.parametrize(
    "order", [[1, 0, *range(2, 12)], [*range(11, -1, -1)], [*range(0, 12, 2), *range(1, 12, 2)]]
)
def test_rows_out_of_order_are_sorted(tmp_path: Path, made_as: Make, order: list[int]) -> None:
    done = imported(made_as(tmp_path / "a", [ROWS[number] for number in order]))
    assert (steering_of(done), steps_s_of(done)) == ([steering for _, steering, _ in ROWS], {0.05})
    assert any("were sorted by time" in notice for notice in done.notices)


@in_formats("several drives, the later one first")
def test_another_drive_that_began_earlier_is_not_mixed_in(tmp_path: Path, made_as: Make) -> None:
    """A file of two drives, the later one first. A log has one clock, so its rows are sorted."""
    later = [(time_s + 100, steering, picture) for time_s, steering, picture in ROWS[:6]]
    done = imported(made_as(tmp_path / "a", [*later, *ROWS[6:]]))
    expected = [*ROWS[6:], *later] if made_as is as_mcap else [*later, *ROWS[6:]]
    assert steering_of(done) == [steering for _, steering, _ in expected]


@in_formats("asks for the unit of the times")
@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6)])
def test_times_in_another_unit_are_asked_about_and_the_flag_mends_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made_as: Make, unit: str, factor: float
) -> None:
    """A csv says seconds and has milliseconds; a log says nanoseconds and has micro- or milliseconds."""
    monkeypatch.setattr("tests.helpers.other_logs.START_NS", 0)
    per_unit = factor if made_as is as_csv else factor / 1e9
    rows = [(time_s * per_unit, steering, picture) for time_s, steering, picture in ROWS]
    asked = imported(made_as(tmp_path / "a", rows))
    assert any(f"`--time-unit {unit}`" in notice for notice in asked.questions)
    assert steps_s_of(imported(made_as(tmp_path / "b", rows), time_unit=unit)) == {0.05}


@in_formats("names with other case, slashes, folders")
@pytest.mark.parametrize(
    "change",
    [str.upper, lambda name: f"C:\\drives\\{name}", lambda name: f"./{name}"],
    ids=["case", "Windows", "dot"],
)
def test_names_of_other_systems(tmp_path: Path, made_as: Make, change: Callable[[str], str]) -> None:
    source, settings = made_as(tmp_path / "a", ROWS)
    table = next(source.glob("*.csv"))
    lines = table.read_text().splitlines()
    begin = 1 if made_as is as_csv else 0
    cells = [line.split(",") for line in lines]
    for row in cells[begin:]:
        row[0] = change(row[0].replace("IMG/", ""))
    table.write_text("\n".join(",".join(row) for row in cells))
    assert (imported((source, settings)).pictures) == 12


def test_accents_that_macos_has_split(tmp_path: Path) -> None:
    source, settings = as_csv(tmp_path / "a", ROWS[:1])
    (source / "0.jpg").rename(source / "e\u0301.jpg")
    (source / "labels.csv").write_text("p,s,t\n\u00e9.jpg,0.5,0\n", "utf-8")
    assert imported((source, settings)).pictures == 1


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("sep=;\np;s;t\n{0};0,5;1\n{1};0,25;2\n", COLUMNS),
        ('p, "s", "t"\n"{0}", 0.5, 1\n{1}, "0.25", 2\n', COLUMNS),
        ("p s t\n{0} 0.5 1\n{1} 0.25 2\n", COLUMNS),
        ("{0} 0.5,2018-07-01 17:09:44:912\n{1} 0.25,2018-07-01 17:09:44:945\n", ("image=1", "steering=2")),
        (
            "p,s,t\n{0},0.5,2024-07-13T14:30:16Z\n{1},0.25,2024-07-13T14:30:17+00:00\n",
            ("image=p", "steering=s", "time=t"),
        ),
    ],
    ids=["Excel", "quotes after blanks", "blanks", "blanks and a comma", "dates"],
)
def test_any_csv(tmp_path: Path, text: str, columns: tuple[str, ...]) -> None:
    source, _ = as_csv(tmp_path / "a", ROWS[:2])
    (source / "labels.csv").write_text("\ufeff" + text.format("0.jpg", "1.jpg"), "utf-8")
    done = imported((source, ImportSettings(columns=columns, rate=None if len(columns) == 3 else 1.0)))
    assert (steering_of(done), steps_s_of(done)) == ([0.5, 0.25], {1.0})


def test_a_row_for_each_camera(tmp_path: Path) -> None:
    """As the tables of a real car: the cameras are some milliseconds apart."""
    source, _ = as_csv(tmp_path / "a", [row for row in ROWS[:4] for _ in range(3)])
    lines = ["p,frame,s,t\n"]
    for number in range(4):
        for at, camera in enumerate(("left_camera", "center_camera", "right_camera")):
            lines.append(f"{3 * number + at}.jpg,{camera},{number / 10},{number / 20 + at / 125}\n")
    (source / "labels.csv").write_text("".join(lines))
    columns = ("image=p", "steering=s", "time_s=t")
    asked = imported((source, ImportSettings(columns=columns)))
    assert any("add camera=frame to --columns?" in notice for notice in asked.questions)
    done = imported((source, ImportSettings(columns=(*columns, "camera=frame"))))
    assert (done.rows, done.pictures, list(done.skipped)) == (4, 12, [])
    assert len(read_messages(done.path)["/camera/left"]) == 4


@pytest.mark.parametrize(
    ("date", "starts_in"), [("2567_07_13", 2024), ("1403_02_31", 1970), ("1445_01_30", 1970)], ids=str
)
def test_calendars_of_other_countries(tmp_path: Path, date: str, starts_in: int) -> None:
    source, settings = as_udacity(tmp_path / "a", ROWS)
    for picture in (source / "IMG").iterdir():
        picture.rename(picture.with_name(picture.name.replace("2024_07_13", date)))
    table = source / "driving_log.csv"
    table.write_text(table.read_text().replace("2024_07_13", date))
    done = imported((source, settings))
    assert (done.rows, done.pictures, steps_s_of(done)) == (12, 12, {0.05})
    first, _ = read_messages(done.path)["/vehicle"][0]
    assert 1970 + first.log_time // (365.25 * 86_400e9) == starts_in


@pytest.mark.parametrize(("age_s", "kept"), [(1.0, 21), (2.0, 31)])
def test_a_command_stays_in_force_as_long_as_it_is_reported(tmp_path: Path, age_s: float, kept: int) -> None:
    from tests.helpers.other_logs import CAMERA, WHEEL, angle, image, write_mcap

    reported = [(WHEEL, 0.0, angle(0.5)), *((CAMERA, number / 20, image(ROWS[0][2])) for number in range(31))]
    source = write_mcap(tmp_path / "sparse.mcap", reported)
    settings = ImportSettings(image=CAMERA, steering=f"{WHEEL}.steering.angle", max_steering_age=age_s)
    assert imported((source, settings)).rows == kept


def test_side_cameras_of_a_log(tmp_path: Path) -> None:
    from tests.helpers.other_logs import CAMERA, WHEEL, angle, image, write_mcap

    reported = [
        message
        for time_s, steering, picture in ROWS
        for message in (
            (WHEEL, time_s, angle(steering)),
            (CAMERA, time_s + 0.001, image(picture)),
            ("/camera/compressed_left", time_s + 0.009, image(picture)),
        )
    ]
    source = write_mcap(tmp_path / "two.mcap", reported)
    settings = ImportSettings(
        image=CAMERA, steering=f"{WHEEL}.steering.angle", camera=("left=/camera/compressed_left",)
    )
    done = imported((source, settings))
    assert (done.rows, done.pictures) == (12, 24)
    assert len(read_messages(done.path)["/camera/left"]) == 12
    with pytest.raises(RecordingError, match="--camera up=/a: expected left=TOPIC or right=TOPIC"):
        imported((source, replace(settings, camera=("up=/a",))))


def test_udacity_s_rows_with_names_that_no_calendar_has(tmp_path: Path) -> None:
    source, settings = as_udacity(tmp_path / "a", ROWS[:1])
    with (source / "driving_log.csv").open("a") as table:
        table.write(paths(1).replace("_07_13_", "_17_13_") + ",0,0,0,1\n")
    done = imported((source, settings))
    assert done.skipped.counts["rows with a time in their pictures' names that no log can hold"] == 1


def test_the_docs_say_what_is_tolerated_in_which_format() -> None:
    page = Path(__file__).parents[2] / "docs" / "importing.md"
    rows = [
        f"| {text} | {' | '.join('yes' if name in names else '' for name in ALL)} |"
        for text, names in TOLERATED.items()
    ]
    table = "\n".join([f"| | {' | '.join(ALL)} |", f"|---|{'---|' * len(ALL)}", *rows])
    assert re.sub(" +", " ", table) in page.read_text("utf-8")
