"""Commands that take a log take the name of a session or drive, too."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from common.errors import UserError
from recorder.log.tags import tags_path
from recorder.log_cli import main as bc_log
from recorder.log_flag import named_log
from tests.helpers.driving import one_line_in
from tests.helpers.logs import write_log
from tests.helpers.udacity import call
from viz.cli import main as bc_play


@pytest.fixture(autouse=True)
def _project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for folder, name in (("sessions", "lake"), ("sessions", "both"), ("drives", "both"), ("drives", "first")):
        Path(folder).mkdir(exist_ok=True)
        write_log(Path(folder) / f"{name}.mcap", [0.0] * 20)


@pytest.mark.parametrize(
    "flags",
    [
        *(["ls"], ["info"], ["check", "--no-look"], ["recover"], ["tag"]),
        *(["trim", "--to", "x.mcap", "--rows", "2", "9"], ["rewrite", "--to", "x.mcap"]),
    ],
    ids=lambda flags: flags[0],
)
def test_a_session_is_named_as_in_bc_index(flags: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_log, flags[0], "lake", *flags[1:]) == 0
    printed = "".join(capsys.readouterr())
    assert "lake" in printed or "x.mcap: " in printed


def test_several_logs_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_log, "merge", "lake", "first", "--to", "x.mcap") == 0
    capsys.readouterr()
    call(bc_log, "copy", "lake", "first", "both")
    assert (
        "sessions/lake.mcap and both/lake.mcap: both are on this machine; copy with `cp sessions/lake.mcap"
        in capsys.readouterr().err
    )
    assert call(bc_log, "tag", "lake", "good", "--rows", "2", "3") == 0
    assert tags_path(Path("sessions/lake.mcap")).is_file()


def test_what_to_type_instead_also_copies_the_tags(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_log, "tag", "lake", "good", "--rows", "2", "3") == 0
    capsys.readouterr()
    assert call(bc_log, "copy", "lake", "drives/to day.mcap") == 1
    output = one_line_in(capsys)
    subprocess.run(output[output.index("`") + 1 : output.rindex("`")], shell=True, check=True)
    assert call(bc_log, "tag", "drives/to day.mcap") == 0
    assert capsys.readouterr().out == "good: rows 2 to 3\n"


def test_bc_play_opens_what_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_play, "first", "--save", "first.rrd") == 0
    assert Path("first.rrd").stat().st_size > 0


def test_a_name_of_two_logs_is_not_guessed(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_log, "info", "both") == 1
    assert one_line_in(capsys) == (
        "bc-log: both: sessions/both.mcap and drives/both.mcap have this name; give one of them"
    )
    with pytest.raises(UserError, match="have this name"):
        named_log(Path("both"))


def test_a_name_that_is_nearly_one_is_recognised(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_log, "info", "laek") == 1
    assert one_line_in(capsys).endswith("did you mean lake?")
