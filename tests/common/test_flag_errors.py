"""A command line that is wrong: one line says what, and what was expected."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from dataset.cli import main as bc_index
from drive.doctor_cli import main as bc_doctor
from model.cli import main as bc_train
from recorder.cli import main as bc_record
from recorder.import_cli import main as bc_import
from recorder.log_cli import main as bc_log
from simulator.cli import main as bc_sim
from tests.helpers.driving import one_line_in
from tests.helpers.udacity import call
from viz.cli import main as bc_play

TRIM = ("trim", "a.mcap", "--to", "b.mcap")


@pytest.mark.parametrize(
    ("command", "flags", "expected"),
    [
        # of another kind than the flag takes
        (bc_train, ["--epochs", "two"], "bc-train: --epochs: expected a whole number"),
        (bc_train, ["--on"], "bc-train: --on: expected SESSION [SESSION ...] after it"),
        (bc_train, ["--alter-each-epoch", "--epochs", "2"], "bc-train: --alter-each-epoch: expected at least one"),
        (bc_index, ["--alter"], "bc-index: --alter: expected at least one word after it"),
        (bc_index, ["a", "--validation", "--no-flip"], "bc-index: --validation: expected SESSION [SESSION ...]"),
        (bc_train, ["--epochs=two"], "bc-train: --epochs: expected a whole number"),
        (bc_record, ["a", "--laps", "two"], "bc-record: --laps: expected a number; `bc-record --help-all`"),
        (bc_record, ["a", "--laps"], "bc-record: --laps: expected a number after it"),
        (bc_record, ["a", "--speed", "fast"], "bc-record: --speed: expected MPH [MPH ...]"),
        (bc_log, [*TRIM, "--rows", "3"], "bc-log: --rows: expected INT INT; `bc-log trim --help-all` has"),
        (bc_index, ["--labels", "raw", "--look"], "bc-index: --labels raw: expected one of as-recorded, auto"),
        (bc_index, ["--recipe", "secret"], "bc-index: --recipe secret: expected one of original, people"),
        # an empty word, of a shell's unset variable, is not the current folder
        (bc_import, ["", "a"], "bc-import: '': expected SOURCE"),
        (bc_record, ["a", "--sessions="], "bc-record: --sessions: expected PATH"),
        (bc_train, ["resume", "--epochs", "2"], "bc-train resume: --epochs: RUN comes first, then the flags"),
        (bc_log, ["ls", ""], "bc-log: '': expected [FOLDER|LOG ...]"),
        (bc_doctor, [""], "bc-doctor: '': expected [PATH]"),
        # a number that is never valid
        (bc_import, ["a", "--rate", "-1"], "bc-import: --rate -1: give frames a second, 1 to"),
        (
            bc_import,
            ["a", "--steering-scale", "0"],
            "bc-import: --steering-scale 0: expected a number other than 0",
        ),
        (bc_import, ["a", "--steering-offset", "inf"], "bc-import: --steering-offset inf: expected a number"),
        (bc_import, ["a", "--max-steering-age", "0"], "bc-import: --max-steering-age 0: expected a number of"),
        # mistyped or missing
        (bc_log, ["inof"], "bc-log: inof: no such command; did you mean info?; `bc-log --help-all` has all flags"),
        (bc_log, ["drive"], "bc-log: drive: no such command; the commands are ls, info, check"),
        (bc_log, [], "bc-log: which command? One of ls, info, check"),
        (bc_record, ["a", "-track"], "bc-record: -track: no such flag; did you mean --track?"),
        (bc_import, ["a", "--colums=b"], "bc-import: --colums: no such flag; did you mean --columns?"),
        (
            bc_log,
            ["info", "a", "--where", "row < 3"],
            "bc-log: --where: no such flag; `bc-log info --help-all`",
        ),
        (bc_index, ["--flip"], "bc-index: --flip: no such flag; did you mean --no-flip?"),
        (bc_index, ["--figures", "f"], "bc-index: --figures: was removed; bc-web shows the balance"),
        (bc_record, ["my", "drive"], "bc-record: drive: one word too many"),
        (bc_play, ["a", "--by", "place", "b"], "bc-play: b: one word too many; put names with"),
        (
            bc_log,
            ["ls", "--sort"],
            "bc-log: --sort: expected {newest,name,rows,duration} after it; `bc-log ls --help-",
        ),
        (bc_import, ["--rate", "1"], "bc-import: SOURCE is missing"),
        (bc_log, TRIM[:2], "bc-log: --to is missing; `bc-log trim --help-all` has all flags"),
        # a speed or a number of laps that is a slip of the finger
        (
            bc_record,
            ["fast", "--speed", "500"],
            "bc-record: --speed 500: expected a set speed above 0 mph and up to 100 (the car reaches",
        ),
        (
            bc_record,
            ["long", "--laps", "1000000"],
            "bc-record: --laps 1e+06: expected a number above 0 and up to 1,000 (a lap takes some",
        ),
        (
            bc_record,
            ["me", "--speed", "500"],
            "bc-record me: --speed 500: expected mph above 0 and up to 100",
        ),
        (bc_sim, ["--laps", "1000000"], "bc-sim: --laps 1e+06: give a number above 0 and up to 1,000"),
        (
            bc_sim,
            ["--expert-speed", "500"],
            "bc-sim: --expert-speed 500: give a set speed above 0 mph and up to 100",
        ),
    ],
)
def test_what_is_wrong_and_what_was_expected_is_said_in_words(
    command: Callable[[], None], flags: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(command, *flags) == 2
    assert one_line_in(capsys).startswith(expected)
