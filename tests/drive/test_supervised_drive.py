"""`bc-drive --simulator TRACK --takeover me` as a process: it waits for the person, and keeps what was counted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from driving import Process, command, untrained_run
from recorder import Log
from recorder.log.topics import DRIVE_METADATA
from recorder.teleop.open_wheels import open_wheels
from waiting import wait_until
from wheel_page import WheelPage

WAITS = "the drive begins when you open the page"


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return untrained_run(tmp_path / "first")


def supervised(run: Path) -> Process:
    flags = ("--takeover", "me", "--no-page", "--viewer", "off", "--log", "drive.mcap")
    return Process(command("bc-drive", run, "--simulator", "lake", *flags))


def results(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / "results.jsonl").read_text().splitlines()]


def drive_and_take_over(process: Process) -> None:
    """A person comes, takes over once, and ends the drive."""
    process.wait_for(WAITS)
    with WheelPage(wait_until(lambda: open_wheels(Path.cwd()))[0]) as page:
        assert page.frame().state["rows"] == 1  # nothing was driven before
        while page.frame().state["drives"] != "human":
            page.steer(0.0, 0.5)
        page.send("end")
        page.text("ended")


def test_the_drive_begins_when_the_page_is_open_and_its_result_is_kept(run: Path) -> None:
    with supervised(run) as process:
        drive_and_take_over(process)
        assert process.join() == 0, process.stderr
    (kept,) = results(run)
    result = kept["result"]
    assert (kept["way"], result["track"], result["set_speed_mph"]) == ("supervised", "lake", 10.0)
    with Log(Path("drive.mcap")) as log:
        counted = log.read_metadata(DRIVE_METADATA)
        assert log.metadata["track"] == "lake"  # the next drive is on the same road
    assert (str(result["by_person"]), counted["manual_stretches"]) == ("1", "1")
    assert (str(result["interventions"]), f"{result['laps']:.3f}") == (counted["interventions"], counted["laps"])


def test_a_result_that_cannot_be_kept_is_something_lost(run: Path) -> None:
    (run / "results.jsonl").mkdir()
    with supervised(run) as process:
        drive_and_take_over(process)
        assert process.join() == 3
    assert any("the result is not kept in the run" in line for line in process.stderr)


def test_ctrl_c_ends_the_wait_for_the_page(run: Path) -> None:
    with supervised(run) as process:
        process.wait_for(WAITS)
        assert process.end() == 1
    assert process.stderr[-1].endswith("nothing was driven: nobody opened the page")
    assert not list(Path.cwd().glob("drive*"))
