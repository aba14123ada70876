"""Whatever is in driving_log.csv, nothing is lost in silence."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from common import Skipped
from recorder import RecordingError
from recorder.sources.clean import clean, rows_to_write
from recorder.sources.imported_rows import SkippedEvents
from recorder.sources.settings import ImportSettings
from recorder.sources.udacity_csv import UTF16_MARKS
from recorder.sources.udacity_recording import CsvTail, read_udacity
from tests.helpers.udacity import paths, picture_name

HEADERS = ["center,left,right,steering,throttle,brake,speed", '"center", "left", "right", "steering"']


def junk() -> st.SearchStrategy[bytes]:
    """Anything that stays within its line: bytes, headers, and rows that are cut off or were never whole."""
    anything = st.binary(max_size=60).map(lambda data: data.replace(b"\n", b"").replace(b"\r", b""))
    pieces = st.sampled_from(
        [*HEADERS, paths(90), "0,5", "-", ",", ".jpg", '"', " ", "nan", "1e999", "1_0", "\u0663", "+", "\0"]
    )
    texts = st.lists(pieces, max_size=8).map(lambda pieces: ",".join(pieces).encode())
    cut = st.builds(lambda data, kept: data[:kept], st.just(f"{paths(91)},0,0,0,1".encode()), st.integers(0, 130))
    return st.one_of(anything, texts, cut)


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """A recording's folder with a single picture."""
    with TemporaryDirectory() as name:
        (Path(name) / "IMG").mkdir()
        (Path(name) / "IMG" / picture_name("center", 99)).touch()
        yield Path(name)


def read(folder: Path, csv: bytes) -> tuple[int, Skipped]:
    """The number of usable rows, and what was skipped."""
    (folder / "driving_log.csv").write_bytes(csv)
    events = SkippedEvents()
    rows = list(rows_to_write(clean(read_udacity(folder), ImportSettings()), events))
    return len(rows), events.skipped


def count_rows(lines: list[bytes]) -> int:
    """How many are neither blank nor a header."""
    lines = [lines[0].removeprefix(b"\xef\xbb\xbf"), *lines[1:]]
    texts = [line.decode("utf-8", "surrogateescape").strip().lower() for line in lines]
    return sum(bool(text) and re.match(r'"?center"?\s*,', text) is None for text in texts)


@given(st.one_of(st.binary(), st.lists(junk(), max_size=6).map(b"\n".join)))
@example(b"\xef\xbb\xbf")
@example(b"\x00" * 100)
def test_any_bytes_give_a_recording_or_a_clear_error(folder: Path, csv: bytes) -> None:
    with contextlib.suppress(RecordingError):
        read(folder, csv)
    if csv.startswith(UTF16_MARKS):
        return
    csv += f"\n{paths(99)},0,0,0,1".encode()
    lines = csv.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    rows, skipped = read(folder, csv)
    assert rows + sum(reason.startswith("rows with ") for reason, _ in skipped) == count_rows(lines)


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
