"""Every benchmark and study that a page names starts with the command that stands there."""

from __future__ import annotations

import importlib.util
import json
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dataset import Samples
from tests.helpers.driving import PATIENCE_S, environment
from tests.helpers.repository import ROOT

PAGES = [ROOT / "benchmarks" / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMAND = re.compile(
    r"^(?:\S+ )*?python ((?:benchmarks|studies)/\w+\.py.*)$|`python ((?:benchmarks|studies)/[^`]+)`", re.M
)

START = """
import argparse, json, runpy, sys

class Started(Exception):
    pass

def parse(parser, *rest, parsed=argparse.ArgumentParser.parse_args):
    parsed(parser, *rest)
    raise Started

argparse.ArgumentParser.parse_args = parse
wrong = {}
for line in json.load(sys.stdin):
    sys.argv, sys.path[0] = line, line[0].rpartition("/")[0]
    try:
        runpy.run_path(line[0], run_name="__main__")
        wrong[" ".join(line)] = "it parses no arguments"
    except Started:
        pass
    except BaseException as error:
        wrong[" ".join(line)] = repr(error)
print(json.dumps(wrong))
"""
"""Runs scripts until they have understood their arguments; all in one process, because each needs PyTorch."""


def commands() -> list[list[str]]:
    """The words of each command after `python`, without comments, optional and further arguments."""
    lines = set[str]()
    for page in PAGES:
        lines |= {first or second for first, second in COMMAND.findall(page.read_text(encoding="utf-8"))}
    return sorted(
        [word.strip("[]") for word in shlex.split(line, comments=True) if word not in ("...", "|", "-")]
        for line in lines
    )


def test_each_command_of_a_page_is_understood() -> None:
    lines = [[str(ROOT / script), *words] for script, *words in commands()]
    assert len({script for script, *_ in lines}) > 20
    done = subprocess.run(
        [sys.executable, "-c", START],
        input=json.dumps(lines),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == {}, done.stderr


def test_the_training_benchmark_takes_an_index_of_another_folder(
    index: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    written = runpy.run_path(str(ROOT / "benchmarks" / "training.py"))["write_pictures"](index, tmp_path, 5)
    with Samples(tmp_path / "index") as samples:
        assert len(samples.of_split("train")) == written == 5


@pytest.mark.parametrize("keras_python", ["keras/bin/python", sys.executable])
def test_that_keras_is_missing_is_one_line(keras_python: str, tmp_path: Path) -> None:
    if keras_python == sys.executable and importlib.util.find_spec("keras"):
        pytest.skip("it is installed here")
    script = ROOT / "benchmarks" / "training.py"
    done = subprocess.run(
        [sys.executable, script, "index", "--keras-python", keras_python],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "no Python with Keras" in done.stderr


@pytest.mark.long
@pytest.mark.parametrize(
    "line",
    [
        "benchmarks/training.py index --samples 8 --rounds 1 --threads 1 --only decoded",
        "benchmarks/indexing.py --logs 3 --frames 3000 --folder logs",
        "benchmarks/indexing.py --log toy.mcap",
        "benchmarks/many_samples.py --samples 30000",
        "benchmarks/loading.py index",
        "benchmarks/from_bucket.py . logs",
        "studies/odd_stretches.py --logs toy.mcap",
    ],
)
def test_it_runs_with_a_small_size(line: str, index: Path, tmp_path: Path) -> None:
    shutil.copytree(index.parent, tmp_path, dirs_exist_ok=True)
    script, *words = line.split()
    done = subprocess.run(
        [sys.executable, ROOT / script, *words],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
