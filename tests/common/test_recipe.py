"""`--recipe original`: everything as the original project did, in the index and in the training."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from common.stored_settings import settings_from
from dataset import IndexConfig, Samples
from dataset.cli import main as bc_index
from model import TrainConfig
from model.cli import main as bc_train
from tests.helpers.toy import toy_index
from tests.helpers.udacity import call


def trained(folder: Path, *flags: object) -> dict[str, Any]:
    """The settings of a training, and of the index that it has built."""
    (folder / "new").mkdir(exist_ok=True)
    places = ["--index", folder / "new" / "index", "--sessions", folder, "--runs", folder / "runs"]
    assert call(
        bc_train, "--name", "run", "--network", "small", "--epochs", 1, "--threads", 1, *flags, *places
    ) in (0, 3)
    config: dict[str, Any] = json.loads((folder / "runs" / "run" / "config.json").read_text())
    return config


@pytest.mark.parametrize("recipe", ["large-steps", "altered", "people", "original"])
def test_the_recipe_is_that_of_the_training_and_of_its_index(tmp_path: Path, recipe: Any) -> None:
    toy_index(tmp_path)
    config = trained(tmp_path, *(["--recipe", recipe] if recipe != "large-steps" else []))
    assert settings_from(TrainConfig, config["training"]) == replace(
        TrainConfig.of(recipe), network="small", epochs=1, threads=1
    )
    assert settings_from(IndexConfig, config["data"]["settings"]) == IndexConfig.of(recipe)
    assert config["data"]["settings"]["recipe"] == ("original" if recipe == "original" else "people")


def test_other_flags_change_what_they_name(tmp_path: Path) -> None:
    toy_index(tmp_path)
    flags = ["--sessions", tmp_path, "--index", tmp_path / "index", "--recipe=original", "--labels", "auto"]
    assert call(bc_index, *flags) in (0, 3)
    with Samples(tmp_path / "index") as samples:
        stored = samples.metadata["settings"]
    assert (stored["recipe"], stored["labels"], stored["bins"]) == ("original", "auto", 25)


def test_settings_of_earlier_versions_are_those_of_the_original_project() -> None:
    for kind in (IndexConfig, TrainConfig):
        stored = {name: value for name, value in asdict(kind.of("original")).items() if name not in kind.EARLIER}
        assert settings_from(kind, json.loads(json.dumps(stored))) == kind.of("original")


def test_a_run_is_repeated_by_its_own_recipe_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    toy_index(tmp_path)
    trained(tmp_path, "--recipe", "original")
    again = ["--like", "run", "--runs", tmp_path / "runs", "--name", "again"]
    assert call(bc_train, *again, "--recipe", "people") == 2
    assert "--recipe with --like" in capsys.readouterr().err
    assert call(bc_train, *again, "--sessions", tmp_path) in (0, 3)
    config = json.loads((tmp_path / "runs" / "again" / "config.json").read_text())
    assert config["training"]["recipe"] == "original"
