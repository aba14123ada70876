"""Each extra: named before any work begins where it is missing, and enough where it is installed."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Final

import pytest
from rosbags.rosbag2 import StoragePlugin

from tests.helpers.installed_toolkit import Toolkit, names_the_extra
from tests.helpers.other_logs import CAMERA, write_bag
from tests.helpers.repository import ROOT

PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ("onnx", ("bc-train", "export", "first", "--onnx", "first.onnx")),
        ("onnx", ("bc-train", "export", "first", "--hub", "hub")),
        ("onnx", ("bc-train", "export", "first", "--donkeycar", "car")),
        ("tensorboard", ("bc-train", "--name", "new", "--tensorboard")),
        ("torchvision", ("bc-train", "--name", "new", "--network", "resnet18")),
        ("scale", ("bc-index", "--ray")),
        ("scale", ("bc-log", "ls", "s3://bucket/sessions")),
        ("scale", ("bc-index", "--sessions", "s3://bucket/sessions")),
        ("ros", ("bc-import", "BAG", "ros", "--image", CAMERA, "--steering", "/cmd_vel.angular.z")),
    ],
)
def test_a_missing_extra_is_named_before_any_work(
    made: Toolkit, tmp_path: Path, extra: str, words: tuple[str, ...]
) -> None:
    if "BAG" in words:
        bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3)
        words = tuple(str(bag) if word == "BAG" else word for word in words)
    assert names_the_extra(made.refused(*words), extra)


def test_an_extra_makes_its_commands_work(extra: tuple[str, Toolkit], tmp_path: Path) -> None:
    name, toolkit = extra
    if name == "onnx":
        toolkit.do("bc-train", "export", "first", "--onnx", tmp_path / "first.onnx")
        toolkit.do("bc-train", "export", "first", "--hub", tmp_path / "hub", "--license", "mit")
        assert (tmp_path / "first.onnx").stat().st_size > 100_000
    elif name == "ros":
        bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3)
        flags = ("--image", CAMERA, "--steering", "/cmd_vel.angular.z", "--steering-scale", -1)
        toolkit.do("bc-import", bag, "bag", *flags, "--sessions", tmp_path)
    elif name == "scale":
        toolkit.do("bc-index", "--index", tmp_path / "index", "--block-s", 2, "--gap-s", 0, "--ray")
    elif name == "tensorboard":
        toolkit.do("bc-train", "--name", "curves", "--network", "small", "--epochs", 1, "--tensorboard")
        assert list((toolkit.folder / "runs/curves/tensorboard").iterdir())
    else:
        small = ("--picture-px", 64, 48, "--epochs", 1)
        toolkit.do("bc-train", "--name", "residual", "--network", "resnet18", *small)


def test_nothing_else_is_an_extra() -> None:
    assert set(PROJECT["optional-dependencies"]) - {"dev", "docs"} == {
        "onnx", "ros", "scale", "tensorboard", "torchvision",
    }  # fmt: skip
