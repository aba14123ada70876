"""A full disk: each command that makes a file names it in one line, and leaves everything as it was."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from recorder.upkeep.edit import merge
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import run
from tests.helpers.logs import START_NS, write_log
from tests.helpers.toy import STEERING, road
from tests.helpers.udacity import make_recording, paths

COMMANDS = {
    "bc-import lake": 2_000,
    "bc-record new --laps 0.005": 2_000,
    "bc-record new --laps 0.005 --udacity recorded": 2_000,
    "bc-log trim toy.mcap --to new.mcap --start 1": 2_000,
    "bc-log merge toy.mcap other.mcap --to new.mcap": 2_000,
    "bc-log split two.mcap --to drives": 2_000,
    "bc-log recover killed.mcap.0a1b2c.part --to new.mcap": 2_000,
    "bc-log export toy.mcap --lerobot dataset": 2_000,
    "bc-log tag toy.mcap exclude --rows 1 5": 10,
    "bc-index toy.mcap other.mcap": 1_000,
    "bc-train --name second --network small --epochs 1": 10,
    "bc-train export first --onnx new.onnx": 100_000,
    "bc-train export first --hub hub": 100_000,
    "bc-play toy.mcap --save new.rrd": 5_000,
    "bc-play toy.mcap --video new.mp4": 1_000,
}
"""Command lines, and the size above which no file can grow, in bytes."""


@pytest.fixture
def folder(project: Path, index: Path, trained: Path) -> Path:
    """A recording, logs, an index and a run."""
    make_recording(project / "lake", "".join(f"{paths(number)},0,1,0,9.5\n" for number in range(3)))
    shutil.copy(index.parent / "toy.mcap", project)
    shutil.copytree(index, project / "index")
    shutil.copytree(trained, project / "runs" / "first")
    other = write_log(project / "other.mcap", STEERING, road, cameras=["center"], start_ns=START_NS + 10**11)
    merge([project / "toy.mcap", other], project / "two.mcap")
    (project / "killed.mcap.0a1b2c.part").write_bytes(other.read_bytes()[:-5_000])
    return project


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != ".lock")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.mark.parametrize(("line", "most_bytes"), COMMANDS.items(), ids=COMMANDS)
def test_a_command_names_the_file_and_leaves_what_was_there(folder: Path, line: str, most_bytes: int) -> None:
    before = contents(folder)
    with files_of_at_most(most_bytes):
        done = run(*line.split())
    assert done.returncode == 1
    error = done.stderr.splitlines()[-1]
    assert "cannot be written" in error
    assert "File too large" in error
    assert "Traceback" not in done.stderr
    assert contents(folder) == before
