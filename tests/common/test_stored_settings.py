"""Settings that come out of somebody's JSON are used only if they are settings."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from common import versions
from common.stored_settings import settings_from
from dataset import IndexConfig
from model import TrainConfig, load_pilot, train
from model.cli import main
from tests.helpers.repository import ROOT
from tests.helpers.toy import ONE
from tests.helpers.udacity import call


def through_json(values: object) -> Any:
    return json.loads(json.dumps(values))


def test_what_was_stored_comes_back() -> None:
    training = TrainConfig(epochs=3, rate=1e-3, device="cpu", threads=2)
    assert settings_from(TrainConfig, through_json(asdict(training))) == training
    index = IndexConfig(per_bin=7, cameras=("left",), where="speed_mph > 5", validation=("a", "b"), gap_s=2)
    assert settings_from(IndexConfig, through_json(asdict(index))) == index


@pytest.mark.parametrize(
    ("kind", "stored"),
    [
        (TrainConfig, None),
        (TrainConfig, [1]),
        (TrainConfig, {"widgets": 1}),
        (TrainConfig, {"epochs": 2.5}),
        (TrainConfig, {"epochs": True}),
        (TrainConfig, {"epochs": "3"}),
        (TrainConfig, {"seed": 2**70}),
        (TrainConfig, {"threads": 10**13}),
        (TrainConfig, {"rate": 10**400}),
        (TrainConfig, {"rate": 10**301}),
        (TrainConfig, {"rate": 1e301}),
        (TrainConfig, {"rate": math.inf}),
        (TrainConfig, {"rate": math.nan}),
        (TrainConfig, {"device": "tpu"}),
        (TrainConfig, {"device": []}),
        (TrainConfig, {"precision": {"x": 1}}),
        (IndexConfig, {"cameras": "center"}),
        (IndexConfig, {"cameras": ["front"]}),
        (IndexConfig, {"bins": 2.5}),
        (IndexConfig, {"validation": [["a"]]}),
        (IndexConfig, {"per_bin": "foo"}),
        (IndexConfig, {"balance": 1}),
        (IndexConfig, {"viewpoints": 2}),
    ],
)
def test_what_is_no_setting_is_refused(kind: type[TrainConfig | IndexConfig], stored: object) -> None:
    wrong = next(iter(stored)) if isinstance(stored, dict) else "object"
    with pytest.raises(ValueError, match=wrong):
        settings_from(kind, stored)


def test_a_fine_tuned_run_is_repeated_from_its_initial_weights(index: Path, trained: Path, tmp_path: Path) -> None:
    shutil.copytree(trained, tmp_path / "base")
    train(index, tmp_path / "tuned", ONE, init=tmp_path / "base")
    places = ["--index", index, "--sessions", index.parent, "--runs", tmp_path]
    assert call(main, "--name", "again", "--like", "tuned", *places) == 0
    tuned, again = load_pilot(tmp_path / "tuned"), load_pilot(tmp_path / "again")
    assert tuned.weights_sha256 == again.weights_sha256
    (tmp_path / "base" / "model.safetensors").write_bytes((tmp_path / "tuned" / "model.safetensors").read_bytes())
    assert call(main, "--name", "third", "--like", "tuned", *places) == 1


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An environment that pip has made; the toolkit is that of this checkout."""
    monkeypatch.setattr("sys.prefix", str(tmp_path / "env"))
    (tmp_path / "env").mkdir()
    (tmp_path / "env" / "pyvenv.cfg").write_text("home = /usr/bin\nversion = 3.12.1\n")
    return tmp_path / "env"


def test_pip_gets_the_versions_of_the_checkout(prefix: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(prefix)
    tested = f"-c {ROOT}/constraints.txt"
    assert versions.install_line("onnx") == f"pip install {tested} -e '{ROOT}[onnx]'"
    assert versions.package_line("rerun-sdk") == f"pip install {tested} rerun-sdk"
    monkeypatch.chdir(ROOT)
    assert versions.install_line("onnx") == "pip install -c constraints.txt -e '.[onnx]'"


def test_uv_and_pipx_are_named_where_they_made_the_environment(
    prefix: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    (prefix / "pipx_metadata.json").write_text("{}")
    line = "pipx runpip behavioural-cloning-toolkit install -c constraints.txt -e '.[onnx]'"
    assert versions.install_line("onnx") == line
    (prefix / "pyvenv.cfg").write_text("home = /usr/bin\nuv = 0.5.1\n")
    assert versions.install_line("onnx") == f"uv pip install --python {prefix} -c constraints.txt -e '.[onnx]'"


@pytest.mark.parametrize(
    ("noted", "expected"),
    [
        ({"url": "file://FOLDER", "dir_info": {}}, "-c FOLDER/constraints.txt 'FOLDER[onnx]'"),
        ({"url": "file:///gone", "dir_info": {}}, "'.[onnx]'"),
        (
            {"url": "https://host/x.git", "vcs_info": {"vcs": "git"}},
            "'behavioural-cloning-toolkit[onnx] @ git+https://host/x.git'",
        ),
    ],
)
def test_an_installed_toolkit_knows_where_it_came_from(
    noted: dict[str, object], expected: str, prefix: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Installed:
        @staticmethod
        def read_text(name: str) -> str:
            return json.dumps(noted).replace("FOLDER", str(tmp_path))

    for name in ("pyproject.toml", "constraints.txt"):
        (tmp_path / name).touch()
    monkeypatch.chdir(prefix)
    monkeypatch.setattr(versions, "__file__", str(prefix / "site-packages" / "common" / "versions.py"))
    monkeypatch.setattr("importlib.metadata.distribution", lambda name: Installed)
    assert versions.install_line("onnx") == f"pip install {expected.replace('FOLDER', str(tmp_path))}"
