"""The commands that bc-play names can be typed as they are, whatever files are called."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from tests.helpers.driving import untrained_run
from tests.helpers.logs import write_log
from tests.helpers.toy import STEERING, road
from tests.helpers.udacity import call
from viz.cli import main
from viz.live.live_log import GrowingLog


def suggested(text: str) -> list[str]:
    """The words of the only command in backquotes, as a shell reads them."""
    (command,) = re.findall("`([^`]*)`", text)
    return shlex.split(command)


def test_a_file_that_was_written_is_opened_by_the_command_that_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(tmp_path / "a.mcap", STEERING, road, cameras=["center"])
    shown, kept = tmp_path / "my drive.rrd", tmp_path / "what it says.mcap"
    assert call(main, log, "--save", shown) == 0
    assert suggested(capsys.readouterr().err)[-1] == str(shown)
    assert call(main, log, "--run", untrained_run(tmp_path / "run"), "--write", kept) == 0
    assert suggested(capsys.readouterr().err)[-1] == str(kept)


def test_the_named_command_recovers_a_killed_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = write_log(tmp_path / "a.mcap", STEERING, road, cameras=["center"]).read_bytes()
    killed = tmp_path / "sunday morning.mcap"
    killed.write_bytes(whole[: len(whole) // 2])
    monkeypatch.setattr("viz.live.live_log.QUIET_S", 0.0)
    with GrowingLog(killed) as log:
        while not log.notice:
            list(log.read())
        assert suggested(log.notice)[-1] == str(killed)
