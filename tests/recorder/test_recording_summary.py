"""What a folder holds is summarised before it is imported, and an import then counts the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from recorder.sources.find_recording import recordings_in
from recorder.sources.import_recording import import_udacity, summarize_recording
from tests.helpers import other_logs, tubs
from tests.helpers.logs import write_log
from tests.helpers.udacity import make_recording, paths

CSV = "".join(f"{paths(number)},0.1,0.5,0,9.5\n" for number in range(4))


def test_a_recording_of_udacity_has_the_rows_and_oddities_of_its_import(tmp_path: Path) -> None:
    make_recording(tmp_path / "lake", CSV + "not a row\n", numbers=(0, 1, 2))
    summary = summarize_recording(tmp_path / "lake")
    imported = import_udacity(tmp_path / "lake", tmp_path / "lake.mcap")
    assert (summary.kind, summary.problem) == ("recording of Udacity's simulator", "")
    assert summary.rows == "4 rows, 10 a second, steering 0.1 to 0.1, most often 0.1"
    assert imported.rows == 4
    assert sorted(summary.oddities) == sorted(imported.skipped.lines(max_names=3))
    assert len(summary.oddities) == 2  # the line, and the fourth row's pictures


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_each_kind_is_recognised(tmp_path: Path, encoding: str) -> None:
    tubs.write_tub_2(tmp_path / "tub", map(tubs.record_2, range(4)), deleted=[1])
    other_logs.write_mcap(tmp_path / "other.mcap", other_logs.DRIVE)
    write_log(tmp_path / "own.mcap", [0.1] * 3)
    (tmp_path / "table").mkdir()
    (tmp_path / "table" / "a.csv").write_text("frame;angle\n1.jpg;0,1\n2.jpg;0,2\n", encoding)
    names = sorted(path.name for path in recordings_in(tmp_path))
    assert names == ["a.csv", "other.mcap", "own.mcap", "tub"]
    tub = summarize_recording(tmp_path / "tub")
    assert tub.kind.startswith("DonkeyCar tub")
    assert tub.oddities[0] == "deleted records: 1 (catalog_0.catalog line 2)"
    other = summarize_recording(tmp_path / "other.mcap")
    assert (other.needs, other.pictures) == ("topics", (other_logs.CAMERA,))
    assert summarize_recording(tmp_path / "own.mcap").is_own
    table = summarize_recording(tmp_path / "table" / "a.csv")
    assert (table.needs, table.names, table.rows) == ("columns", ("frame", "angle"), "2 rows")


def test_recordings_are_found_deeper_and_pictures_beside_them_are_not(tmp_path: Path) -> None:
    make_recording(tmp_path / "data" / "lake", CSV)
    make_recording(tmp_path / "mountain", CSV)
    assert recordings_in(tmp_path) == [tmp_path / "mountain", tmp_path / "data" / "lake"]
    assert recordings_in(tmp_path / "mountain") == [tmp_path / "mountain"]
    assert recordings_in(tmp_path / "mountain" / "IMG") == []


def test_what_cannot_be_imported_has_its_reason(tmp_path: Path) -> None:
    (tmp_path / "driving_log.csv").write_text("")
    assert "no drive was recorded" in summarize_recording(tmp_path).problem
    (tmp_path / "x.mcap").write_bytes(b"no log")
    assert "x.mcap" in summarize_recording(tmp_path / "x.mcap").problem
