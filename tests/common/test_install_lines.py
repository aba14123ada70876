"""The command that installs what is missing: by what has made this environment, with the tested versions."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from common import versions
from tests.helpers.repository import ROOT


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
