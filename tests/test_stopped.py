"""A command that is stopped while it writes: Ctrl-C leaves nothing, a kill leaves nothing that looks finished."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.helpers.driving import Process, command
from tests.helpers.logs import write_log
from tests.helpers.toy import STEERING, road
from tests.helpers.waiting import wait_until

COMMANDS = {
    "bc-record new --laps 50": "sessions/new.mcap.*.part",
    "bc-record new --laps 50 --udacity recorded": "recorded/IMG/*.jpg",
    "bc-play long.mcap --video new.mp4 --overlay": "new.mp4.*.part",
    "bc-log export long.mcap --lerobot dataset --video": "dataset.*/**/*.mp4",
}
"""Command lines, and the files that they have begun to write when they are stopped."""


@pytest.fixture
def folder(project: Path) -> Path:
    write_log(project / "long.mcap", STEERING * 20, lambda _, row: road("center", row % 40), cameras=["center"])
    return project


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL], ids=lambda number: number.name)
@pytest.mark.parametrize(("line", "begun"), COMMANDS.items(), ids=COMMANDS)
def test_a_command_that_is_stopped_leaves_no_half_file(
    folder: Path, line: str, begun: str, number: signal.Signals
) -> None:
    before = sorted(folder.rglob("*"))
    with Process(command(*line.split())) as process:
        wait_until(lambda: list(folder.glob(begun)))
        code = process.end(number)
    left = sorted(path for path in folder.rglob("*") if path not in before)
    if number == signal.SIGKILL:
        assert code == -signal.SIGKILL
        assert not [path for path in left if path.name in ("new.mcap", "new.mp4", "driving_log.csv", "dataset")]
    else:
        assert code == 130
        assert "Traceback" not in "".join(process.stderr)
        assert left == []
