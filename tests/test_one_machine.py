"""Who has one machine needs nothing that speaks to stores or clusters, and does not load it."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import pytest

import make_architecture
from dataset.cli import main as bc_index
from drive.evaluation.eval_cli import main as bc_eval
from model.cli import main as bc_train
from model.runs_cli import main as bc_runs
from recorder.log_cli import main as bc_log
from tests.helpers.logs import write_log
from tests.helpers.repository import ROOT
from tests.helpers.toy import STEERING, road
from tests.helpers.udacity import call

EXTRAS = ("ray", "obstore", "boto3")


def loaded_with(path: Path) -> set[str]:
    """The modules that a file imports when it is imported itself, and not only in a function or for its types."""
    loaded = set[str]()
    waiting: list[ast.AST] = [*ast.parse(path.read_text(encoding="utf-8")).body]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Try | ast.ExceptHandler):
            waiting += ast.iter_child_nodes(node)
        elif isinstance(node, ast.Import):
            loaded |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            loaded |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return loaded


def those_that_load() -> set[str]:
    """The modules of ours that import one of the extras, or another one of these."""
    modules = {
        path.relative_to(ROOT).with_suffix("").as_posix().removesuffix("/__init__").replace("/", "."): path
        for room in make_architecture.ROOMS
        for path in make_architecture.modules(room)
    }
    loads = {name: loaded_with(path) for name, path in modules.items()}
    speaking = {name for name, loaded in loads.items() if {module.split(".")[0] for module in loaded} & {*EXTRAS}}
    speaking.add("common.ray_cluster")  # it imports Ray when it connects
    while more := {name for name, loaded in loads.items() if loaded & speaking} - speaking:
        speaking |= more
    return speaking


def test_commands_work_where_neither_obstore_nor_ray_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*EXTRAS, *those_that_load()):
        monkeypatch.setitem(sys.modules, name, None)  # Python's own way to say: cannot be imported
    monkeypatch.chdir(tmp_path)
    log = write_log(Path("sessions/toy.mcap"), STEERING, road, cameras=["center"])
    assert call(bc_log, "info", log) == call(bc_log, "check", log) == call(bc_log, "ls", "sessions") == 0
    assert call(bc_index, "--block-s", "0.5", "--gap-s", "0", "--look", "--check") == 0
    assert call(bc_train, "--name", "a", "--network", "small", "--epochs", 1, "--batch", 10, "--threads", 1) == 0
    assert call(bc_train, "resume", "a", "--epochs", 2) == 0
    assert call(bc_eval, "a") == call(bc_runs) == 0


def test_no_command_loads_them() -> None:
    speaking = those_that_load()
    assert speaking >= {"common.object_store", "recorder.upkeep.copy_log"}
    begun = re.findall(
        r'_command\("bc-[\w-]+", "([\w.]+)"\)', (ROOT / "behavioural_cloning_toolkit.py").read_text()
    )
    assert len(begun) > 10
    assert speaking & {*begun, *make_architecture.ROOMS} == set()
