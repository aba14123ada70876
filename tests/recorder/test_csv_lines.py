"""The lines of a csv that another program is still appending to."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from recorder.sources.csv_lines import CsvTail
from tests.helpers.growing_files import WAYS, begin_again


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


def test_a_file_that_is_appended_to_is_not_read_again(tmp_path: Path) -> None:
    csv = tmp_path / "driving_log.csv"
    csv.write_bytes(b"".join(b"line %d\n" % number for number in range(1000)))
    tail = CsvTail(csv)
    assert len(tail.new_lines()) == 1000
    with csv.open("r+b") as stream:
        stream.write(b"LINE")  # whoever reads the beginning again sees a line that is new
        stream.seek(0, os.SEEK_END)
        stream.write(b"the last\n")
    assert tail.new_lines() == [(1001, b"the last")]


@pytest.mark.parametrize(
    "text", [b"b\nd\n", b"a\nd\n", b"a\nb\nx\nd\n", b"d\n", b"new\nb\nc\nd\n", b"d\nd\nb\nd\n"]
)
@pytest.mark.parametrize("way", WAYS)
def test_of_a_csv_that_begins_again_only_new_lines_are_given(tmp_path: Path, text: bytes, way: str) -> None:
    csv = tmp_path / "driving_log.csv"
    csv.write_bytes(b"a\nb\nc\npart")
    tail = CsvTail(csv)
    assert tail.new_lines() == [(1, b"a"), (2, b"b"), (3, b"c")]
    begin_again(tail, text, way)
    lines = list(enumerate(text.splitlines(), 1))
    assert tail.new_lines() == [(number, line) for number, line in lines if line not in (b"a", b"b", b"c")]
    with csv.open("ab") as stream:
        stream.write(b"c\nd\ne\nb")
    assert tail.new_lines() == [(len(lines) + 2, b"d"), (len(lines) + 3, b"e")]
    assert tail.rest() == []
