"""The toolkit as its users have it: the wheel in an environment with nothing but what the README's line installs.

`make test-installed` makes that environment, build/installed/base. The tests run in the project's own one, and
start the commands of the other.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.installed_toolkit import Toolkit
from tests.helpers.needs import INSTALLED
from tests.helpers.repository import ROOT


@pytest.fixture(scope="session")
def base() -> Path:
    return INSTALLED / "base"


@pytest.fixture(scope="session")
def made(base: Path, tmp_path_factory: pytest.TempPathFactory) -> Toolkit:
    """A project with two sessions, an index, a run and a drive. Tests add to it, and change nothing."""
    toolkit = Toolkit(base, tmp_path_factory.mktemp("user") / "project")
    toolkit.folder.mkdir()
    toolkit.do("bc-record", "lake", "--laps", 0.12, "--udacity", "recording")
    toolkit.do("bc-record", "mountain", "--track", "mountain", "--laps", 0.05)
    toolkit.do("bc-index", "--block-s", 2, "--gap-s", 0)
    toolkit.do("bc-train", "--name", "first", "--network", "small", "--epochs", 1)
    toolkit.do("bc-drive", "first", "--log", "drives/run.mcap", "--simulator", "lake", "--laps", 0.02)
    return toolkit


@pytest.fixture(scope="module", params=["onnx", "ros", "scale", "tensorboard", "torchvision"])
def extra(
    request: pytest.FixtureRequest, made: Toolkit, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Toolkit]:
    """An extra's name, and the same project with an environment that has this extra. Packages of the base
    environment are seen, not installed again."""
    environment = tmp_path_factory.mktemp(request.param) / "environment"
    subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    (site,) = environment.glob("lib/python*/site-packages")
    (seen,) = made.environment.glob("lib/python*/site-packages")
    (site / "base.pth").write_text(f"{seen}\n")
    (wheel,) = INSTALLED.glob("*.whl")
    pip = [str(environment / "bin" / "pip"), "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--no-deps", "--force-reinstall", str(wheel)], check=True)  # its commands
    subprocess.run([*pip, "-c", str(ROOT / "constraints.txt"), f"{wheel}[{request.param}]"], check=True)
    return request.param, Toolkit(environment, made.folder)
