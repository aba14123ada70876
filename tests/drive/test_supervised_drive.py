"""`bc-drive --simulator TRACK --takeover me` as a process: it waits for the person, and keeps what was counted."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drive.at_wheel import PUT_BACK
from recorder import Log
from recorder.teleop.wheel import open_wheels
from recorder.topics import DRIVE_METADATA
from tests.helpers.driving import Process, command, untrained_run
from tests.helpers.waiting import wait_until
from tests.helpers.wheel_page import Shown, WheelPage

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
        assert page.frame().state["rows"] <= 10  # nothing was driven before; newer frames replace unsent ones
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


def test_the_page_shows_large_or_recorded_pictures_and_puts_the_car_back(run: Path) -> None:
    with supervised(run) as process:
        process.wait_for(WAITS)
        with WheelPage(wait_until(lambda: open_wheels(Path.cwd()))[0]) as page:
            hello, large = page.text("hello"), page.frame()
            page.send("view", recorded=True)
            while size_of(shown := page.frame()) != (320, 160):
                page.steer(0.0, 0.5)
            before = shown.state["put_back"]
            page.send("put_back")
            while page.frame().state["put_back"] == before:
                page.steer(0.0, 0.5)
            page.send("end")
            why = page.text("ended")["why"]
        assert process.join() == 0, process.stderr
    assert re.fullmatch(r"the drive has ended after 0\.\d\d laps; the car was put back [1-9] times?", why)
    assert (hello["track"], hello["picture_hz"], size_of(large)) == ("lake", 25, (640, 320))
    with Log(Path("drive.mcap")) as log:
        texts = [event.message for _, event in log.decoded("/events")]
        assert log.picture(shown.state["rows"] - 1) == shown.jpeg
        (asked,) = [number for number, text in enumerate(texts) if text == PUT_BACK]
        assert any("the simulator put the car back" in text for text in texts[asked:])


def size_of(shown: Shown) -> tuple[int, int]:
    picture = cv2.imdecode(np.frombuffer(shown.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture.shape[1], picture.shape[0]


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
    assert process.stderr[-1].endswith("nothing was driven: the page was not opened")
    assert not list(Path.cwd().glob("drive*"))
