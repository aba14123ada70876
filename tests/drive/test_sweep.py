"""`bc-sweep`: many trainings, each driven; what is done is not done again, what fails does not stop the rest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from drive.sweep_cli import main
from toy import toy_index
from udacity import call

SWEEP = """
seeds = [1, 2]
[train]
epochs = 1
batch = 10
network = "small"
dropout = 0.0
precision = "float32"
threads = 1
[grid]
rate = [1e-4, 1e30]
[drive]
simulator = ["lake"]
laps = 0.001
"""


def printed(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_each_setting_runs_with_each_seed_and_failures_stand_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    toy_index(tmp_path)
    Path("rates.toml").write_text(SWEEP)
    assert call(main, "rates.toml", "--json") == 3
    found = {line["run"]: line for line in printed(capsys)}
    assert list(found) == [
        "rates-rate_0.0001-seed1",
        "rates-rate_0.0001-seed2",
        "rates-rate_1e+30-seed1",
        "rates-rate_1e+30-seed2",
    ]
    assert [bool(line["failure"]) for line in found.values()] == [False, False, True, True]
    assert "no longer finite" in found["rates-rate_1e+30-seed1"]["failure"]
    done = found["rates-rate_0.0001-seed2"]
    assert (done["settings"]["rate"], done["settings"]["seed"], done["summary"]["epochs"]) == (1e-4, 2, 1)
    assert [drive["track"] for drive in done["summary"]["results"]] == ["lake"]

    weights = Path("runs/rates-rate_0.0001-seed2/model.safetensors")
    trained_at, logs = weights.stat().st_mtime_ns, sorted(Path("drives").iterdir())
    Path("rates.toml").write_text(SWEEP.replace(", 1e30", ""))  # goes on: nothing is left to do
    assert call(main, "rates.toml") == 0
    shown = capsys.readouterr()
    assert "rate 0.0001" in shown.out
    assert (weights.stat().st_mtime_ns, sorted(Path("drives").iterdir())) == (trained_at, logs)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("seeds = [", "not a sweep"),
        ("[grid]\nrates = [1]", "unknown settings: rates; did you mean rate?"),
        ("[grid]\nrate = []", "not a sweep"),
        ("[train]\nseed = 1", "seeds = [...]"),
        ("[grid]\nrate = [1]\n[[trainings]]\nrate = 2", "give one of the two"),
        ("[grid]\nrate = [-1]", "--rate -1"),
        ("[drive]\nsimulator = ['lkae']", "did you mean lake?"),
        ("seeds = [1, 1]", "two trainings are the same"),
    ],
)
def test_a_file_that_is_no_sweep_is_told_before_anything_is_trained(
    content: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.toml").write_text(content)
    assert call(main, tmp_path / "x.toml", "--runs", tmp_path / "runs") == 1
    assert told in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_file_that_is_not_there_is_told_with_what_was_meant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(main, "nothere.toml") == 1
    assert (
        "nothere.toml: cannot be read (No such file or directory); a file of settings" in capsys.readouterr().err
    )
    Path("rates.toml").write_text(SWEEP)
    assert call(main, "rate.toml") == 1
    assert "did you mean rates.toml?" in capsys.readouterr().err
