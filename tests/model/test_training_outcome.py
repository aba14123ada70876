"""What a training says in the end: why which epoch is kept, and what natural answers change."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from model.cli import main
from model.runs.history import read_history
from model.runs.training_outcome import outcome_lines
from tests.helpers.histories import epoch_line, write_lines
from tests.helpers.toy import toy_index
from tests.helpers.udacity import call


def told(folder: Path, kept: int, *lines: dict[str, object]) -> list[str]:
    folder.mkdir(exist_ok=True)
    write_lines(folder / "metrics.jsonl", lines)
    history, skipped = read_history(folder)
    assert not len(skipped)
    return outcome_lines(history.epochs, kept)


def line(
    epoch: int, rmse_deg: float, balanced_deg: float, mean_balanced_deg: float | None = 9.0
) -> dict[str, object]:
    """An epoch whose one bin has the balanced RMSE; always the mean has an RMSE of 4.5."""
    made = epoch_line(epoch)
    made["validation"] |= {"rmse_deg": rmse_deg}
    made["bins"] = [made["bins"][0] | {"frames": 100, "rmse_deg": balanced_deg}]
    if mean_balanced_deg is not None:
        made["mean"] |= {"balanced_rmse_deg": mean_balanced_deg}
    return made


def test_why_the_kept_epoch_is_not_that_of_the_least_rmse(tmp_path: Path) -> None:
    epochs = [line(1, 3.0, 5.0), line(2, 2.5, 6.0), line(3, 4.0, 7.0)]
    (line_of_epochs,) = told(tmp_path / "a", 1, *epochs)
    assert line_of_epochs.startswith(
        "epoch 1 is kept for its balanced RMSE (5.00 against 6.00) and not epoch 2 for its RMSE"
        " (2.50 against 3.00)"
    )
    assert told(tmp_path / "b", 2, line(1, 3.0, 6.0), line(2, 2.5, 5.0)) == []  # it has both


def test_the_command_ends_with_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    index = toy_index(tmp_path)
    places = ["--index", index, "--sessions", tmp_path, "--runs", tmp_path / "runs"]
    settings = ["--network", "small", "--epochs", 2, "--batch", 8, "--rate", 1e-4, "--threads", 1]
    assert call(main, "--name", "first", *settings, *places) == 0
    *_, of_scale, _, verdict, advice = capsys.readouterr().out.splitlines()
    epochs = [
        json.loads(line) for line in (tmp_path / "runs" / "first" / "metrics.jsonl").read_text().splitlines()
    ]
    best = min(epochs, key=driving_error)
    assert f"on turns ({best['validation']['turning_mae_deg']:.2f} against" in verdict
    assert f"driving error ({driving_error(best):.2f} against 2.00)" in verdict
    assert advice.startswith("next: `")
    answers = best["answers"]["scale"], 25 * best["answers"]["offset"]
    scale, curve, *others = [float(number) for number in re.findall(r"[+-]?\d+\.\d+", of_scale)]
    assert curve == pytest.approx(best["answers"]["curve"] / 25, abs=0.0006)
    expected = [*answers, best["validation"]["rmse_deg"], best["learnt"]["rmse_deg"]]
    assert [scale, *others] == pytest.approx(expected, abs=0.006)


def driving_error(epoch: dict[str, Any]) -> float:
    share: float = epoch["balanced_rmse_deg"] / epoch["mean"]["balanced_rmse_deg"]
    return share + 1 - (epoch["validation"]["correlation"] or 0.0)
