"""`bc-train --alter-each-epoch`: what a run keeps of it, and that it is measured unaltered. How it goes on:
test_resume.py."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dataset.config import EPOCH_ALTERATIONS
from model import train
from model.cli import main
from model.evaluation.evaluate import evaluate
from model.runs.history import read_epochs
from model.runs.provenance import training_of
from tests.helpers.toy import SMALL
from tests.helpers.udacity import call

CONFIG = replace(SMALL, epochs=2, batch=6, keep="last", alter_each_epoch=("all",))


@pytest.fixture(scope="module")
def whole(index: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("runs") / "whole"
    train(index, run, CONFIG)
    return run


def settings(run: Path) -> dict[str, Any]:
    stored: dict[str, Any] = json.loads((run / "config.json").read_text())["training"]
    return stored


def weights(run: Path) -> bytes:
    return (run / "model.safetensors").read_bytes()


def test_it_changes_what_is_learnt_and_each_choice_is_another(index: Path, whole: Path, tmp_path: Path) -> None:
    learnt = {weights(whole)}
    for names in (("none",), ("move",), ("noise", "box")):
        run = tmp_path / names[0]
        train(index, run, replace(CONFIG, alter_each_epoch=names))
        learnt.add(weights(run))
    assert len(learnt) == 4


def test_frames_held_out_are_measured_as_they_were_recorded(index: Path, whole: Path) -> None:
    """`evaluate` knows nothing of a training's settings."""
    last = read_epochs(whole)[-1]
    measures = evaluate(whole, index).measures
    assert last.epoch == 2
    assert last.measures.network.rmse_deg == pytest.approx(measures.network.rmse_deg, rel=1e-4)


def test_the_command_keeps_it_and_like_and_resume_repeat_it(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = ["--runs", tmp_path, "--index", index, "--sessions", index.parent]
    flags = ["--network", "small", "--batch", 6, "--threads", 1]
    chosen = ["--alter-each-epoch", "noise", "move"]
    assert call(main, "--name", "first", "--epochs", 1, *flags, *chosen, *places) == 0
    assert settings(tmp_path / "first")["alter_each_epoch"] == ["noise", "move"]
    assert call(main, "--like", "first", "--name", "second", *places) == 0
    assert weights(tmp_path / "second") == weights(tmp_path / "first")
    assert call(main, "--like", "first", "--name", "third", "--alter-each-epoch", "none", *places) == 0
    assert weights(tmp_path / "third") != weights(tmp_path / "first")
    assert call(main, "resume", "first", "--epochs", 2, *places) == 0
    assert settings(tmp_path / "first")["alter_each_epoch"] == ["noise", "move"]
    capsys.readouterr()
    assert call(main, "resume", "first", "--epochs", 3, "--alter-each-epoch", "all", *places) == 1
    assert "began with --alter-each-epoch" in capsys.readouterr().err


def test_all_of_version_0_3_are_those_it_had(index: Path, whole: Path, tmp_path: Path) -> None:
    run = shutil.copytree(whole, tmp_path / "earlier")
    config = json.loads((run / "config.json").read_text())
    del config["training"]["light"]
    (run / "config.json").write_text(json.dumps(config))
    settings = training_of(config, run)
    assert settings.epoch_alterations == tuple(name for name in EPOCH_ALTERATIONS if name != "mix")
    assert settings.light == "as-seen"
