"""Whatever is in driving_log.csv: a row in a known style is read, and nothing is lost in silence."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from common import Skipped
from recorder import RecordingError
from recorder.sources.clean import clean, rows_to_write
from recorder.sources.imported_rows import RecordedRow, SkippedEvents
from recorder.sources.settings import ImportSettings
from recorder.sources.udacity_csv import UTF16_MARKS
from recorder.sources.udacity_recording import CsvTail, read_udacity
from tests.helpers.udacity import paths, picture_name

Values = tuple[float, float, float, float]
HEADERS = ["center,left,right,steering,throttle,brake,speed", '"center", "left", "right", "steering"']
PREFIXES = [
    "",
    "IMG/",
    "IMG\\",
    "../IMG/",
    "C:\\self driving\\data\\IMG\\",
    "/home/b-sh/My Drives (new)/IMG/",
    "/Users/José/Anna’s MacBook/IMG/",
    "/data/laps 1, 2 and 3/IMG/",
    "/old.jpg/IMG/",
]
# Of each, what the simulator can write: steering, throttle, brake, speed.
UNITS = st.sampled_from(["0", "1", "0.5", "0.05", "0.1286689", "0.9999999"])
SIGNED = st.builds(lambda sign, unit: unit if unit == "0" else sign + unit, st.sampled_from(["", "-"]), UNITS)
SPEEDS = st.sampled_from(["0.5", "12.1822", "22.40861", "30.19", "7.8E-05", "5.197608E-05"])
NUMBERS = st.tuples(SIGNED, UNITS, st.sampled_from(["0", "1"]), SPEEDS)


MINUS_SIGN = "\u2212"


@dataclass(frozen=True)
class Line:
    """A line of the csv, and the values of the row that it is (None: it is no row of the simulator's)."""

    content: bytes
    values: Values | None


def written(number: str, decimal_sign: str, minus: str) -> str:
    """A number as .NET writes it for a country; the minus is a prefix, or "behind"."""
    text = number.replace(".", decimal_sign)
    if minus == "behind" and text.startswith("-") and decimal_sign != ",":
        return f"{text[1:]}-"
    return text.replace("-", "-" if minus == "behind" else minus)


@st.composite
def rows(draw: st.DrawFn, number: int, decimal_sign: str, minus: str) -> Line:
    """A row in any of the known styles; its pictures are named by its number."""
    separator, path_separator = draw(st.sampled_from([",", ", "])), draw(st.sampled_from([",", ", "]))
    numbers = draw(NUMBERS)
    cells = [written(text, decimal_sign, minus) for text in numbers]
    joined_paths = paths(number, draw(st.sampled_from(PREFIXES)), path_separator)
    if draw(st.booleans()):  # one camera; a path may have a comma in it
        center = joined_paths[: joined_paths.index(picture_name("center", number))] + picture_name(
            "center", number
        )
        joined_paths = center + 2 * path_separator
    text = f"{joined_paths},{separator[1:]}{separator.join(cells)}"
    steering, throttle, brake, speed_mph = map(float, numbers)
    encoding = draw(st.sampled_from(["utf-8", "mac_roman"])) if "".join(cells).isascii() else "utf-8"
    return Line(text.encode(encoding), (steering, throttle, brake, speed_mph))


def junk() -> st.SearchStrategy[Line]:
    """Anything that stays within its line: bytes, headers, and rows that are cut off or were never whole."""
    anything = st.binary(max_size=60).map(lambda data: data.replace(b"\n", b"").replace(b"\r", b""))
    pieces = st.sampled_from(
        [*HEADERS, paths(90), "0,5", "-", ",", ".jpg", '"', " ", "nan", "1e999", "1_0", "\u0663", "+", "\0"]
    )
    texts = st.lists(pieces, max_size=8).map(lambda pieces: ",".join(pieces).encode())
    cut = st.builds(lambda data, kept: data[:kept], st.just(f"{paths(91)},0,0,0,1".encode()), st.integers(0, 130))
    return st.one_of(anything, texts, cut).map(lambda data: Line(data, None))


@st.composite
def recordings(draw: st.DrawFn) -> tuple[list[Line], bytes]:
    """Lines in their order, and the csv that holds them: of one country."""
    count = draw(st.integers(0, 4))
    decimal_sign = draw(st.sampled_from([".", ",", "/", "\u066b"]))
    minus = draw(st.sampled_from(["-", MINUS_SIGN, f"\u200e{MINUS_SIGN}", "\u061c-", "behind"]))
    lines = [Line(f"{paths(99)},0,0,0,1".encode(), (0.0, 0.0, 0.0, 1.0))]
    for number in range(count):
        lines += draw(st.lists(junk(), max_size=2))
        lines.append(draw(rows(number, decimal_sign, minus)))
    end = draw(st.sampled_from([[b"\n"], [b"\r\n"], [b"\r"], [b"\n", b"\r\n"]]))
    csv = b"".join(line.content + end[position % len(end)] for position, line in enumerate(lines))
    return lines, csv if draw(st.booleans()) else csv.removesuffix(end[(len(lines) - 1) % len(end)])


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """A recording's folder with a single picture."""
    with TemporaryDirectory() as name:
        (Path(name) / "IMG").mkdir()
        (Path(name) / "IMG" / picture_name("center", 99)).touch()
        yield Path(name)


@dataclass
class Read:
    """All that was read of a recording."""

    rows: list[RecordedRow]
    pictures: dict[str, str]  # file name -> path
    skipped: Skipped


def read(folder: Path, csv: bytes) -> Read:
    (folder / "driving_log.csv").write_bytes(csv)
    events = SkippedEvents()
    recording = read_udacity(folder)
    names = [str(picture) for row in recording.rows for picture in row.pictures.values()]
    assert recording.folder is not None
    pictures = {name: path for name in names if (path := recording.folder.find(name)) is not None}
    written = list(rows_to_write(clean(recording, ImportSettings()), events))
    return Read([row for row in recording.rows if not row.problem][: len(written)], pictures, events.skipped)


def rows_skipped(recording: Read) -> int:
    return sum(reason.startswith("rows with ") for reason, _ in recording.skipped)


def count_rows(lines: list[bytes]) -> int:
    """How many are neither blank nor a header."""
    lines = [lines[0].removeprefix(b"\xef\xbb\xbf"), *lines[1:]]
    texts = [line.decode("utf-8", "surrogateescape").strip().lower() for line in lines]
    return sum(bool(text) and re.match(r'"?center"?\s*,', text) is None for text in texts)


@given(recordings())
def test_known_styles_are_read_and_the_rest_is_counted(folder: Path, made: tuple[list[Line], bytes]) -> None:
    lines, csv = made
    recording = read(folder, csv)
    by_line = {row.name: row for row in recording.rows}
    for number, line in enumerate(lines, start=1):
        if line.values is not None:
            row = by_line[f"line {number}"]
            assert (row.steering, row.throttle, row.brake, row.speed) == line.values
    assert len(recording.rows) + rows_skipped(recording) == count_rows([line.content for line in lines])


@given(
    st.one_of(st.binary(), st.lists(junk(), max_size=6).map(lambda lines: b"\n".join(x.content for x in lines)))
)
@example(b"\xef\xbb\xbf")
@example(b"\x00" * 100)
def test_any_bytes_give_a_recording_or_a_clear_error(folder: Path, csv: bytes) -> None:
    with contextlib.suppress(RecordingError):
        read(folder, csv)
    if csv.startswith(UTF16_MARKS):
        return
    csv += f"\n{paths(99)},0,0,0,1".encode()
    lines = csv.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    recording = read(folder, csv)
    assert len(recording.rows) + rows_skipped(recording) == count_rows(lines)


def test_lines_are_given_once_each_when_they_have_their_end(tmp_path: Path) -> None:
    csv = tmp_path / "driving_log.csv"
    tail = CsvTail(csv)
    assert tail.new_lines() == []
    given = []
    for text in (b"one\r", b"\n", b"two\rthr", b"ee\n\nfi", b"ve\r", b"six\n", b"two\nsev"):
        with csv.open("ab") as stream:
            stream.write(text)
        given.append(tail.new_lines())
        assert tail.new_lines() == []
    assert given == [
        [(1, b"one")],
        [],
        [(2, b"two")],
        [(3, b"three"), (4, b"")],
        [(5, b"five")],
        [(6, b"six")],
        [(7, b"two")],
    ]
    assert tail.rest() == [(8, b"sev")]


@pytest.mark.parametrize("way", ["shortened", "another file", "deleted first"])
def test_a_csv_that_begins_again_is_read_again(tmp_path: Path, way: str) -> None:
    csv = tmp_path / "driving_log.csv"
    csv.write_bytes(b"a\nb\nc\npart")
    tail = CsvTail(csv)
    assert tail.new_lines() == [(1, b"a"), (2, b"b"), (3, b"c")]
    if way == "deleted first":
        csv.unlink()
        assert tail.new_lines() == []
    if way == "another file":
        csv.rename(tmp_path / "earlier")
    csv.write_bytes(b"a\nd\n")
    assert tail.new_lines() == [(1, b"a"), (2, b"d")]
    with csv.open("ab") as stream:
        stream.write(b"e\nb")
    assert tail.new_lines() == [(3, b"e")]
    assert tail.rest() == [(4, b"b")]
