"""What can go wrong with a training costs one clear line, and never what was learnt before."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from common.car import Camera
from common.process_settings import usable_cores
from dataset import IndexConfig, build_index
from model import RunError, load_pilot, train
from model.cli import main
from model.errors import RunWriteError
from model.runs.history import read_history
from model.runs.run_files import run_write_errors
from model.runs.training_progress import outcome_lines
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import one_line_in
from tests.helpers.histories import epoch_line, write_lines
from tests.helpers.logs import write_log
from tests.helpers.toy import ONE, SMALL, STEERING, road, toy_index
from tests.helpers.udacity import call


def test_an_infinite_loss_ends_the_training_and_names_the_way_out(index: Path, tmp_path: Path) -> None:
    with pytest.raises(
        RunError, match=r"no longer finite in epoch 1; train again with a --rate smaller than 1e\+30"
    ):
        train(index, tmp_path / "run", replace(SMALL, rate=1e30))
    assert not (tmp_path / "run").exists()  # nothing was learnt: the name is free


def test_what_was_good_before_is_kept(index: Path, trained: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(trained, tmp_path / "run"))
    checkpoint = run / "last" / "checkpoint.safetensors"
    with safe_open(checkpoint, framework="np") as file:
        stored = {name: value for name, value in file.metadata().items() if name != "sha256"}
    tensors = load_file(checkpoint)
    for name in tensors:
        if name.startswith("exp_avg."):
            tensors[name].fill(1e38)  # the next step throws the weights beyond all numbers
    save_file(tensors, checkpoint, stored)
    before = {path: path.read_bytes() for path in run.rglob("*.safetensors")}
    with pytest.raises(RunError, match=r"is kept: `bc-train continue \S*/run` with a --rate smaller than 0\.0002"):
        train(index, run, replace(ONE, epochs=2), resume=True)
    assert {path: path.read_bytes() for path in run.rglob("*.safetensors")} == before


def test_nothing_for_training_is_one_line_and_leaves_no_run(tmp_path: Path) -> None:
    log = write_log(tmp_path / "toy.mcap", STEERING, road, cameras=["center"])
    held_out = build_index([log], tmp_path / "index", IndexConfig(validation=("toy",))).path
    with pytest.raises(RunError, match=r"samples\.parquet: no training samples"):
        train(held_out, tmp_path / "run", ONE)
    assert not (tmp_path / "run").exists()


def test_nothing_held_out_trains_all_the_same_and_keeps_the_last_epoch(tmp_path: Path) -> None:
    log = write_log(tmp_path / "toy.mcap", STEERING, road, cameras=["center"])
    all_of_it = build_index([log], tmp_path / "index", IndexConfig(validation_share=0)).path
    trained = train(all_of_it, tmp_path / "run", replace(ONE, epochs=2, patience=1))
    assert [(epoch.is_best, math.isnan(epoch.validation_loss)) for epoch in trained.epochs] == [(True, True)] * 2
    line = json.loads((tmp_path / "run" / "metrics.jsonl").read_text().splitlines()[1])
    assert (line["validation_loss"], line["validation"]["rmse_deg"], line["bins"]) == (None, None, [])


def broken_at(*rows: int) -> Callable[[Camera, int], bytes]:
    """Begins and ends as a JPEG does, and holds nothing."""
    return lambda camera, row: b"\xff\xd8\xff" + bytes(500) + b"\xff\xd9" if row in rows else road(camera, row)


def test_pictures_that_do_not_decode_are_left_out_named_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(tmp_path / "toy.mcap", STEERING, broken_at(2, 3), cameras=["center"])
    index = build_index([log], tmp_path / "index", IndexConfig(flip=False, block_s=0.5, gap_s=0)).path
    places = ["--index", index, "--sessions", tmp_path, "--runs", tmp_path / "runs"]
    assert call(main, "--name", "run", "--network", "small", "--epochs", 2, "--batch", 8, *places) == 3
    printed = capsys.readouterr().err
    assert "skipped pictures that do not decode: 2 (toy row 2 center, toy row 3 center)" in printed
    assert load_pilot(tmp_path / "runs" / "run")


def test_no_picture_at_all_that_decodes_is_one_line(tmp_path: Path) -> None:
    log = write_log(tmp_path / "toy.mcap", STEERING, broken_at(*range(40)), cameras=["center"])
    index = build_index([log], tmp_path / "index", IndexConfig(flip=False, block_s=0.5, gap_s=0)).path
    with pytest.raises(RunError, match="none of its training pictures decodes; see `bc-index --look`"):
        train(index, tmp_path / "run", ONE)


def test_a_training_stops_early_when_nothing_gets_better(index: Path, tmp_path: Path) -> None:
    """A rate at which nothing moves: the first epoch stays the best one."""
    trained = train(index, tmp_path / "run", replace(ONE, epochs=9, rate=1e-30, patience=2))
    assert [epoch.is_best for epoch in trained.epochs] == [True, False, False]
    assert trained.is_stopped_early
    again = train(index, tmp_path / "run", resume=True)
    assert (again.epochs, again.is_stopped_early) == ([], True)


def test_a_run_starts_from_the_weights_of_another(index: Path, trained: Path, tmp_path: Path) -> None:
    frozen = replace(ONE, rate=1e-30)
    run = tmp_path / "run"
    train(index, run, frozen, init=trained)
    assert load_pilot(run).weights_sha256
    ours, theirs = (load_file(folder / "model.safetensors") for folder in (run, trained))
    assert all(np.abs(ours[name] - theirs[name]).max() < 1e-20 for name in theirs)
    reported = json.loads((run / "config.json").read_text())["init"]
    assert reported["run"] == "first"
    assert reported["weights_sha256"] == load_pilot(trained).weights_sha256
    assert reported["data"][0]["fingerprint"]


def test_that_the_run_it_starts_from_knows_what_is_held_out_is_said(
    index: Path, trained: Path, tmp_path: Path
) -> None:
    assert train(index, tmp_path / "same", ONE, init=trained).notices == []
    log = index.parent / "toy.mcap"
    other = build_index([log], tmp_path / "index", IndexConfig(flip=False, block_s=0.5, gap_s=0, seed=9)).path
    [notice] = train(other, tmp_path / "other", ONE, init=trained).notices
    assert "first has learnt from" in notice


def test_the_last_epoch_can_be_asked_for_instead_of_the_best(trained: Path) -> None:
    last, best = load_pilot(trained / "last"), load_pilot(trained)
    picture = best.crop(np.zeros((160, 320, 3), np.uint8))
    assert last.predict(picture) == best.predict(picture)
    assert (best.run, last.run) == ("first", "first-last")
    assert last.weights_sha256 != best.weights_sha256  # of the file


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"training": {"epochs": 1, "widgets": 3}}, "unknown settings: widgets"),
        ({"training": {"epochs": -1}}, "epochs"),
        ({"training": []}, "cannot be used"),
        ({"data": {}}, "does not name the data"),
        ({"format": 99}, "of format 99"),
    ],
)
def test_a_config_that_cannot_be_gone_on_with_is_named(
    index: Path, trained: Path, tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    run = Path(shutil.copytree(trained, tmp_path / "run"))
    config = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(json.dumps(config | change))
    with pytest.raises(RunError, match=message) as caught:
        train(index, run, resume=True)
    assert "config.json" in str(caught.value)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--name", "good"], "good: exists already; give another --name, or continue it: `bc-train resume"),
        (["continue", "nobody"], "nobody: no trained run there"),
        (
            ["continue", "runs/goood"],
            "bc-train continue: runs/goood: no trained run there (model.safetensors is missing); did you",
        ),
        (
            ["continue", "hub/bad"],
            "bc-train continue: hub/bad: no trained run there (model.safetensors is missing); in ",
        ),
        (["continue", "damaged"], "config.json: cannot be read"),
        (["--tensorboard"], "--tensorboard needs TensorBoard: install it with"),
    ],
)
def test_what_can_fail_at_once_fails_before_an_index_is_built(
    index: Path,
    trained: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    flags: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    shutil.copytree(trained, Path("runs") / "good")
    shutil.copytree(trained, Path("runs") / "damaged")
    (Path("runs") / "damaged" / "config.json").write_text("{")
    before = sorted(tmp_path.rglob("*"))
    assert call(main, *flags, "--sessions", index.parent) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--epochs", -1], "--epochs -1: expected a whole number from 0 to 1,000,000"),
        (["--micro-batch", -1], "--micro-batch -1: expected a whole number from 0"),
        (["--seed", -1], "--seed -1: expected a whole number from 0"),
        (["--rate", 0], "--rate 0: expected a number above 0"),
        (["--rate", "nan"], "--rate nan: expected a number above 0"),
        (["--dropout", 1], "--dropout 1: expected a number from 0 to 1"),
        (["--keep", "last", "--patience", 3], "--patience 3: not with --keep last"),
        (["--alter-each-epoch", "all", "move"], "--alter-each-epoch all move: expected each once"),
        (["--alter-each-epoch", "none", "move"], "--alter-each-epoch none move: expected each once"),
        (["--alter-each-epoch", "move", "move"], "--alter-each-epoch move move: expected each once"),
        (["--takeovers", "drives/run.mcap"], "--takeovers: was removed; `bc-train continue RUN --takeovers LOG`"),
        (["--threads", 16 * usable_cores() + 1], f"--threads {16 * usable_cores() + 1}: expected"),
        (["--name", "a/b"], "--name 'a/b': expected a plain name"),
        (["--name", "drive"], "--name drive: a verb of a command"),  # `bc-eval drive` would not find it
        (["--name=-x"], "--name '-x': expected a plain name"),  # `bc-drive -x` would take it for a flag
    ],
)
def test_bad_usage_names_the_flag(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    flags: list[object],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(main, *flags) == 2
    assert one_line_in(capsys).startswith(f"bc-train: {message}")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_names_the_file_and_the_way_on(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = ["--index", index, "--sessions", index.parent, "--runs", tmp_path]
    flags = ["--network", "small", "--batch", 8, "--threads", 1, "--precision", "float32"]
    assert call(main, "--name", "first", "--epochs", 1, *flags, *places) == 0
    capsys.readouterr()
    with files_of_at_most(800_000):
        assert call(main, "resume", "first", "--epochs", 2, "--runs", tmp_path) == 1
    hint, error = capsys.readouterr().err.splitlines()
    path = tmp_path / "first" / "last" / "checkpoint.safetensors"
    assert error == f"bc-train resume: {path}: cannot be written (File too large); make room"
    assert hint.endswith(f"continue with `bc-train resume {tmp_path / 'first'}`")
    with files_of_at_most(10):
        assert call(main, "--name", "second", *flags, *places) == 1
    assert "second/config.json: cannot be written (File too large); make room" in capsys.readouterr().err
    assert not (tmp_path / "second").exists()


def reported(folder: Path, kept: int, *lines: dict[str, object]) -> list[str]:
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
    (line_of_epochs,) = reported(tmp_path / "a", 1, *epochs)
    assert line_of_epochs.startswith(
        "epoch 1 is kept for its balanced RMSE (5.00 against 6.00) and not epoch 2 for its RMSE"
        " (2.50 against 3.00)"
    )
    assert reported(tmp_path / "b", 2, line(1, 3.0, 6.0), line(2, 2.5, 5.0)) == []  # it has both


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


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "make room"),
        (errno.EROFS, "choose a folder that you may write to"),
        (errno.EISDIR, "check the folder"),
    ],
)
def test_a_run_that_cannot_be_written_names_the_cause_and_its_remedy(number: int, remedy: str) -> None:
    with pytest.raises(RunWriteError) as raised, run_write_errors(Path("runs/a")):
        raise OSError(number, os.strerror(number))
    assert str(raised.value) == f"runs/a: cannot be written ({os.strerror(number)}); {remedy}"
