"""`bc-import` names sessions, says what it has recognised, and asks; `bc-record --from` still leads to it."""

from __future__ import annotations

from pathlib import Path

import pytest

from recorder.cli import main as bc_record
from recorder.import_cli import main as bc_import
from tests.helpers.driving import one_line_in
from tests.helpers.recorded_formats import as_csv, as_mcap, as_udacity
from tests.helpers.udacity import call, jpeg

ROWS = [(number / 20, (number % 5 - 2) / 10, jpeg(60 + number)) for number in range(12)]


def test_a_session_gets_the_name_of_its_recording(cwd: Path) -> None:
    as_udacity(cwd / "my drive", ROWS)
    as_mcap(cwd / "robot", ROWS)
    topics = ("--image", "/camera/compressed", "--steering", "/wheel.steering.angle")
    assert call(bc_import, "my drive") == 0
    assert call(bc_import, cwd / "robot" / "other.mcap", *topics) == 0
    assert call(bc_import, "my drive", "another") == 0
    assert sorted(path.name for path in (cwd / "sessions").iterdir()) == [
        "another.mcap", "my-drive.mcap", "other.mcap",
    ]  # fmt: skip


def test_a_name_that_is_taken_is_refused_with_a_free_one(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    as_udacity(cwd / "drive", ROWS)
    assert call(bc_import, "drive") == 0
    before = (cwd / "sessions" / "drive.mcap").read_bytes()
    capsys.readouterr()
    assert call(bc_import, "drive") == 1
    error = one_line_in(capsys)
    assert "drive-2" in error
    assert "--force" in error
    assert (cwd / "sessions" / "drive.mcap").read_bytes() == before


def test_it_reports_what_it_has_recognised_and_asks(cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    as_csv(cwd / "table", [(time_s, 0.53 + (0 if number % 3 else 0.1), picture)
                           for number, (time_s, _, picture) in enumerate(ROWS)])  # fmt: skip
    columns = ("--columns", "image=p", "steering=s", "time_s=t")
    assert call(bc_import, "table", *columns) == 0
    assert capsys.readouterr().err.splitlines()[:3] == [
        "table/labels.csv: pictures with a csv, 12 rows, 20 a second, steering 0.53 to 0.63, most often 0.53",
        "steering lies between 0.53 and 0.63: `--steering-offset -0.53`, if 0.53 is straight on?",
        "It is imported as it is. If the answer is yes, import it again with the flag and --force.",
    ]
    assert call(bc_import, "table", *columns, "--steering-offset", -0.53, "--force") == 0
    assert "?" not in capsys.readouterr().err


@pytest.mark.parametrize("flag", [["--from", "drive"], ["--from=drive"]])
def test_bc_record_from_imports_and_names_the_new_command(
    cwd: Path, capsys: pytest.CaptureFixture[str], flag: list[str]
) -> None:
    as_udacity(cwd / "drive", ROWS)
    assert call(bc_record, "mine", *flag) == 0
    assert "bc-record --from is now `bc-import drive mine`" in capsys.readouterr().err
    assert (cwd / "sessions" / "mine.mcap").is_file()
