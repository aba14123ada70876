"""What a training says in the end: better or worse than knowing nothing, and why which epoch is kept."""

from __future__ import annotations

import json
import math
import re
import statistics
from pathlib import Path

import numpy as np
import pytest

from histories import epoch_line, write_lines
from model.cli import main
from model.metrics import measure
from model.runs.history import read_history
from model.runs.training_outcome import verdict
from toy import toy_index
from udacity import call


def told(folder: Path, kept: int, *lines: dict[str, object]) -> list[str]:
    folder.mkdir(exist_ok=True)
    write_lines(folder / "metrics.jsonl", lines)
    history, skipped = read_history(folder)
    assert not len(skipped)
    return verdict(history.epochs, kept)


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


def test_better_and_no_better_than_the_mean(tmp_path: Path) -> None:
    assert told(tmp_path / "a", 1, line(1, 2.0, 3.0)) == [
        "better than always predicting the mean: RMSE 2.00 against 4.50 degrees, balanced RMSE 3.00 against 9.00"
        " degrees"
    ]
    [said] = told(tmp_path / "b", 1, line(1, 4.6, 9.1))
    assert said.startswith("no better than always predicting the mean: RMSE 4.60 against 4.50")


def test_better_only_where_bins_count_alike_is_said_as_it_is(tmp_path: Path) -> None:
    [said] = told(tmp_path / "a", 1, line(1, 5.0, 6.0))
    assert "no better in RMSE (5.00 against 4.50 degrees), better in balanced RMSE (6.00 against 9.00" in said


def test_why_the_kept_epoch_is_not_that_of_the_least_rmse(tmp_path: Path) -> None:
    epochs = [line(1, 3.0, 5.0), line(2, 2.5, 6.0), line(3, 4.0, 7.0)]
    first, second = told(tmp_path / "a", 1, *epochs)
    assert first.startswith("better than")
    assert second.startswith(
        "epoch 1 is kept for its balanced RMSE (5.00 against 6.00) and not epoch 2 for its RMSE"
        " (2.50 against 3.00)"
    )
    assert len(told(tmp_path / "b", 2, line(1, 3.0, 6.0), line(2, 2.5, 5.0))) == 1  # it has both


def test_runs_that_tell_less_are_judged_by_what_they_tell(tmp_path: Path) -> None:
    [said] = told(tmp_path / "earlier", 1, line(1, 2.0, 3.0, mean_balanced_deg=None))
    assert said == "better than always predicting the mean: RMSE 2.00 against 4.50 degrees"
    assert told(tmp_path / "nothing held out", 1, epoch_line(1, frames=0)) == []
    assert told(tmp_path / "none", 0, line(1, 2.0, 3.0)) == []


def test_the_mean_has_its_balanced_error_too() -> None:
    """Two bins, of 8 and 2 frames: those of the mean are off by what they are from it."""
    recorded = [0.0] * 8 + [0.5] * 2
    found = measure(np.zeros(10), np.array(recorded))
    mean = statistics.fmean(recorded)
    assert found.mean_balanced_rmse_deg == pytest.approx(25 * math.sqrt((mean**2 + (0.5 - mean) ** 2) / 2))


@pytest.mark.usefixtures("without_figures")
def test_the_command_ends_with_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    index = toy_index(tmp_path)
    places = ["--index", index, "--sessions", tmp_path, "--runs", tmp_path / "runs"]
    assert (
        call(main, "--name", "first", "--network", "small", "--epochs", 2, "--batch", 8, "--threads", 1, *places)
        == 0
    )
    *_, said, of_scale, _ = capsys.readouterr().out.splitlines()
    epochs = [
        json.loads(each) for each in (tmp_path / "runs" / "first" / "metrics.jsonl").read_text().splitlines()
    ]
    best = min(epochs, key=lambda epoch: epoch["balanced_rmse_deg"])
    numbers = [float(number) for number in re.findall(r"\d+\.\d\d", said)]
    expected = [
        best["validation"]["rmse_deg"],
        best["mean"]["rmse_deg"],
        best["balanced_rmse_deg"],
        best["mean"]["balanced_rmse_deg"],
    ]
    assert numbers == pytest.approx(expected, abs=0.006)
    answers = best["answers"]["scale"], 25 * best["answers"]["offset"]
    scale, curve, *told = [float(number) for number in re.findall(r"[+-]?\d+\.\d+", of_scale)]
    assert curve == pytest.approx(best["answers"]["curve"] / 25, abs=0.0006)
    told = [scale, *told]
    assert told == pytest.approx([*answers, expected[0], best["learnt"]["rmse_deg"]], abs=0.006)
