"""`help(dataset)` begins with an example and with what one calls."""

from __future__ import annotations

import ast
import inspect
import pydoc
from types import ModuleType

import pytest

import dataset
import model


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
