"""The README's lines can be pasted after the installation that it describes."""

from __future__ import annotations

import re
import shlex
from typing import Final

import pytest

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
        if "--simulator" in line:
            assert recorded.issuperset(line[line.index("--simulator") + 1 :]), line


@pytest.mark.parametrize("line", re.findall(r"^.*install.*constraints\.txt.*$", README, re.MULTILINE))
def test_what_it_shows_is_installed_by_what_it_says(line: str) -> None:
    assert line.endswith(" .")  # no extra
    assert [text for text in NEEDS if text in README] == []
