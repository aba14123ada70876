"""The README's lines can be pasted after the installation that it describes."""

from __future__ import annotations

import re
import shlex
import tomllib
from typing import Final

import pytest

from repository import ROOT

README: Final = (ROOT / "README.md").read_text(encoding="utf-8")
LOOP: Final = README.partition("## The loop\n")[2].partition("\n## ")[0]
NEEDS: Final = {
    "bc-web": "web",
    "--video": "video",
    "--onnx": "onnx",
    "--hub": "onnx",
    "--tensorboard": "tensorboard",
}


def commands(block: str) -> list[list[str]]:
    return [words for line in block.splitlines() if (words := shlex.split(line, comments=True))]


def test_the_loop_waits_for_nobody_and_uses_what_it_has_made() -> None:
    lines = commands(re.findall(r"```sh\n(.*?)```", LOOP, re.DOTALL)[0])
    recorded = {line[1] for line in lines if line[0] == "bc-record"}
    for line in lines:
        assert line[0] != "bc-web"
        assert line[0] != "bc-play" or "--video" in line, line
        if "--simulator" in line:
            assert recorded.issuperset(line[line.index("--simulator") + 1 :]), line


@pytest.mark.parametrize("line", re.findall(r"^.*install.*constraints\.txt.*$", README, re.MULTILINE))
def test_what_it_shows_is_installed_by_what_it_says(line: str) -> None:
    extras = set(re.search(r"\.\[([\w,]+)\]", line)[1].split(","))  # type: ignore[index]
    needed = {extra for text, extra in NEEDS.items() if text in README}
    assert extras >= needed >= {"web"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert extras <= project["optional-dependencies"].keys()
