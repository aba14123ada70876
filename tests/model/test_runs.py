"""A run is found, read, and its pilot steers; a damaged one is an error that names the file."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from model import RunError, find_run, load_pilot
from model.runs.run_files import locked_for_training, new_run_name
from model.runs.run_folder import create_run, find_any_run


def edit(path: Path, **values: Any) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **values}))


def cut_weights(run: Path) -> None:
    weights = run / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1000])


def no_weights(run: Path) -> None:
    (run / "model.safetensors").unlink()


def garbage_weights(run: Path) -> None:
    (run / "model.safetensors").write_bytes(b"garbage" * 100)


def other_weights(run: Path) -> None:
    save_file({"weight": np.zeros((3, 3), np.float32)}, run / "model.safetensors")


def one_other_shape(run: Path) -> None:
    weights = load_file(run / "model.safetensors")
    name = next(name for name, tensor in weights.items() if tensor.shape == (1, 16))
    save_file({**weights, name: np.zeros((1, 11), np.float32)}, run / "model.safetensors")


def no_config(run: Path) -> None:
    (run / "config.json").unlink()


def garbage_config(run: Path) -> None:
    (run / "config.json").write_bytes(b"\xff{")


def newer_format(run: Path) -> None:
    edit(run / "config.json", format=9)


def other_preprocessing(run: Path) -> None:
    edit(run / "config.json", preprocessing={"channels": "RGB"})


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (cut_weights, r"model\.safetensors: cannot be read"),
        (no_weights, r"model\.safetensors: cannot be read"),
        (garbage_weights, r"model\.safetensors: cannot be read"),
        (other_weights, r"model\.safetensors: weights of another network"),
        (one_other_shape, r"model\.safetensors: weights of another network"),
        (no_config, r"config\.json: cannot be read"),
        (garbage_config, r"config\.json: cannot be read"),
        (newer_format, r"config\.json: of format 9"),
        (other_preprocessing, r"config\.json: trained with another preprocessing"),
    ],
)
def test_a_damaged_run_is_a_run_error_that_names_the_file(
    trained: Path, tmp_path: Path, damage: Callable[[Path], None], message: str
) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained, run)
    damage(run)
    with pytest.raises(RunError, match=message) as caught:
        load_pilot(run)
    assert "\n" not in str(caught.value)


def test_trainings_that_begin_in_the_same_second_have_names_of_their_own() -> None:
    names = [new_run_name() for _ in range(14)]
    assert len(set(names)) == 14
    assert all(re.fullmatch(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d-[0-9a-f]{6}", name) for name in names)


def test_a_run_that_is_being_trained_is_waited_for(tmp_path: Path) -> None:
    create_run(tmp_path / "first", {})
    with (
        locked_for_training(tmp_path / "first"),
        pytest.raises(RunError, match=r"is being trained, .*: wait for it"),
    ):
        find_run("first", tmp_path)


def test_a_name_that_is_nearly_that_of_a_run_is_recognised(tmp_path: Path) -> None:
    for name in ("first", "second", "2026-01-01_10-00-00"):
        create_run(tmp_path / name, {})
        (tmp_path / name / "model.safetensors").touch()
    for find in (find_run, find_any_run):
        with pytest.raises(RunError, match=r"frist: no .*; did you mean first\?$"):
            find("frist", tmp_path)
        with pytest.raises(RunError, match=r"; in \S+ are 2026-01-01_10-00-00, first, second$"):
            find("something else", tmp_path)
