"""`--help` fits on a screen, `--help-all` shows every flag, and rare flags work as all others do."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from dataset.cli import main as bc_index
from drive.cli import main as bc_drive
from drive.evaluation.eval_cli import main as bc_eval
from model.cli import main as bc_train
from recorder.cli import main as bc_record
from recorder.import_cli import main as bc_import
from recorder.log_cli import main as bc_log
from tests.helpers.udacity import call
from viz.cli import main as bc_play

SCREEN_LINES = 60


@pytest.fixture(autouse=True)
def narrow_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


@pytest.mark.parametrize("command", [bc_record, bc_import, bc_drive, bc_train, bc_index, bc_eval, bc_play, bc_log])
def test_help_fits_on_a_screen(command: Callable[[], None], capsys: pytest.CaptureFixture[str]) -> None:
    assert call(command, "--help") == 0
    assert 10 < len(capsys.readouterr().out.splitlines()) <= SCREEN_LINES


def test_help_all_shows_what_help_leaves_out(capsys: pytest.CaptureFixture[str]) -> None:
    shown = {}
    for flag in ("--help", "--help-all"):
        assert call(bc_train, flag) == 0
        shown[flag] = capsys.readouterr().out
    assert "--help-all" in shown["--help"]
    assert "--epochs" in shown["--help"]
    assert "--micro-batch" not in shown["--help"]
    assert {"--epochs", "--micro-batch"} <= set(shown["--help-all"].split())


def test_help_shows_the_defaults_of_the_recipe(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_index, "--recipe", "original", "--help") == 0
    assert "(default: as-recorded)" in " ".join(capsys.readouterr().out.replace("│", "").split())


def test_help_of_a_subcommand_is_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(bc_log, "trim", "--help") == 0
    assert "--rows" in capsys.readouterr().out
