"""The README's lines can be pasted after the installation that it describes."""

from __future__ import annotations

import ast
import inspect
import pydoc
import re
import shlex
from types import ModuleType
from typing import Final

import pytest

import dataset
import model
from tests.helpers.repository import ROOT

README: Final = (ROOT / "README.md").read_text(encoding="utf-8")
LOOP: Final = README.partition("## The loop\n")[2].partition("\n## ")[0]
NEEDS: Final = ("--onnx", "--hub", "--tensorboard", "resnet18", "--ray", "s3://")
"""What needs an extra."""


def commands(block: str) -> list[list[str]]:
    return [words for line in block.splitlines() if (words := shlex.split(line, comments=True))]


def test_the_loop_waits_for_nobody_and_uses_what_it_has_made() -> None:
    lines = commands(re.findall(r"```sh\n(.*?)```", LOOP, re.DOTALL)[0])
    recorded = {line[1] for line in lines if line[0] == "bc-record"}
    for line in lines:
        assert line[0] != "bc-web"
        assert line[0] != "bc-play" or "--video" in line, line
        for flag in {"--simulator", "--tracks"}.intersection(line):
            assert recorded.issuperset(line[line.index(flag) + 1 :]), line


@pytest.mark.parametrize("line", re.findall(r"^.*install.*constraints\.txt.*$", README, re.MULTILINE))
def test_what_it_shows_is_installed_by_what_it_reports(line: str) -> None:
    assert line.endswith(" .")  # no extra
    assert [text for text in NEEDS if text in README] == []


@pytest.mark.parametrize("package", [dataset, model], ids=lambda package: package.__name__)
def test_help_begins_with_an_example_and_every_function(package: ModuleType) -> None:
    text = pydoc.render_doc(package, renderer=pydoc.plaintext)  # type: ignore[attr-defined]
    begins = text.partition("PACKAGE CONTENTS")[0]
    functions = [name for name in package.__all__ if inspect.isfunction(getattr(package, name))]
    assert len(functions) >= 5
    words = begins.partition("DESCRIPTION")[2].replace(",", " ").split()
    assert [name for name in functions if name not in words] == []


@pytest.mark.parametrize("package", [dataset, model], ids=lambda package: package.__name__)
def test_its_example_calls_what_there_is(package: ModuleType) -> None:
    lines = inspect.cleandoc(package.__doc__ or "").splitlines()
    code = ast.parse(inspect.cleandoc("\n".join(line for line in lines if line.startswith("    ") or not line)))
    names: dict[str, object] = {}
    exec(compile(ast.Module([n for n in code.body if isinstance(n, ast.ImportFrom)], []), "help", "exec"), names)
    calls = [node for node in ast.walk(code) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    called = {node.func.id: node for node in calls if isinstance(node.func, ast.Name) and node.func.id in names}
    assert len(called) >= 4
    for name, node in called.items():
        flags = {keyword.arg: keyword.value for keyword in node.keywords if keyword.arg is not None}
        inspect.signature(names[name]).bind(*node.args, **flags)  # type: ignore[arg-type]
