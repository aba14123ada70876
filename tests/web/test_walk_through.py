"""One walk through the workbench, as somebody would go: what a killed recording has left is saved and cleaned, an
index made of it, a network trained, and its drive looked at. What each step has done is checked with the commands
and in the files."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow.parquet as pq
import pytest

import dataset.cli
import model.runs_cli
import recorder.log_cli
from recorder import Log
from tests.helpers.driving import road_jpeg
from tests.helpers.logs import write_log
from tests.helpers.pages import drag, open_session, opened_page, press
from tests.helpers.udacity import call
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROWS = 300
STUCK = (50, 75)
WORST = (150, 209)


def write_sessions(folder: Path) -> None:
    """A sound session, and one with two stretches of stuck steering, the second the longer one; it was killed."""
    steering = 0.4 * np.sin(np.arange(ROWS) / 9)
    write_log(folder / "sound.mcap", steering[:200].tolist(), lambda camera, row: road_jpeg(row))
    for first, last in (STUCK, WORST):
        steering[first : last + 1] = 0.25
    whole = write_log(folder.parent / "whole.mcap", steering.tolist(), lambda camera, row: road_jpeg(1000 + row))
    (folder / "damaged.mcap.0a1b2c.part").write_bytes(whole.read_bytes()[:-100])


def start(page: Page, form: str, **values: str) -> None:
    """Fill one of the forms of the page of jobs, and wait until the command has ended well."""
    page.click("#jobs-now >> text=Activity")
    page.click(f"summary >> text='{form}'")
    within = page.locator("details[open]")
    for name, value in values.items():
        field = within.locator(f"[name={name}]")
        if field.evaluate("field => field.tagName") == "SELECT":
            field.select_option(value)
        else:
            field.fill(value)
    within.locator("button").click()
    made(page)


def made(page: Page, state: str = "done") -> None:
    """Wait on the page of a job until it has ended in this way, and go to what it has made."""
    page.wait_for_selector("#job .state:not(:text('running'))")
    assert page.inner_text("#job .state") == state, page.inner_text("pre")
    page.click("#job p:has(.state) a")  # a run, which has its page from the beginning, or what else was made


def test_from_a_damaged_session_to_its_drive(
    browser: Browser, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_sessions(tmp_path / "sessions")
    log = tmp_path / "sessions" / "damaged.mcap"
    folders = "--sessions", log.parent, "--index", tmp_path / "index"
    assert call(dataset.cli.main, "sound", *folders, "--labels", "as-recorded") == 0
    with served(tmp_path) as bench, opened_page(browser, f"{bench.address}/sessions") as page:
        # the recording that was killed is saved as far as it is whole
        page.select_option("[name=only]", "unfinished or damaged")
        page.click("text=damaged.mcap")
        open_session(page)
        assert page.locator(".main:visible").all_inner_texts() == ["Recover"]
        assert page.is_hidden("#exclude")  # its tags would be lost
        page.click(".rescue button")
        made(page)
        open_session(page)
        with Log(log) as opened:
            saved = len(opened.vehicle())
        assert saved == ROWS  # the end that is missing has none
        next(log.parent.glob("*.part")).unlink()  # as bc-log says, once it is saved

        # the session with the most odd rows, and its worst stretch
        page.click("nav >> text=Recordings")
        page.select_option("[name=sort]", "most odd rows")
        wait_until(lambda: page.locator(".session .name").first.inner_text() == "damaged")
        page.locator(".session .name").first.click()
        open_session(page)
        odd = [
            [int(row) for row in re.findall(r"\d+", line)[:2]]
            for line in page.locator("#odd li").all_inner_texts()
        ]
        assert max(odd, key=lambda rows: rows[1] - rows[0]) == list(WORST)

        rows = drag(page, *WORST, saved)
        assert list(rows) == pytest.approx(WORST, abs=3)
        press(page, "x", 1)
        assert excluded(log, capsys) == [rows]
        press(page, "u", 0)
        assert excluded(log, capsys) == []
        page.keyboard.press("Escape")  # else an edge of what is selected would be dragged
        assert drag(page, *WORST, saved) == rows
        press(page, "x", 1)
        assert excluded(log, capsys) == [rows]

        page.goto(f"{bench.address}/index")
        assert "damaged" in page.inner_text(".problem")  # it is newer than the index
        start(page, "Index", labels="as-recorded")
        page.wait_for_url("**/index")
        assert page.locator(".problem").count() == 0
        page.click("text=Check it for leaks")
        page.wait_for_selector("#leaks:text('no leak')")
        assert call(dataset.cli.main, "--check", *folders) == 0
        used = used_rows(tmp_path)
        assert len(used) > saved / 4
        assert not used & set(range(rows[0], rows[1] + 1))

        start(page, "Train", name="walked", epochs="1", network="small")
        page.wait_for_selector("text=1 learnt of 1")
        page.wait_for_selector("#plots[data-shown='walked'] canvas")
        config = json.loads((tmp_path / "runs" / "walked" / "config.json").read_text())
        assert set(config["data"]["logs"]) == {"damaged", "sound"}
        capsys.readouterr()
        assert call(model.runs_cli.main, "--runs", tmp_path / "runs", "--json") == 0
        assert '"walked"' in capsys.readouterr().out

        page.click("text=this project's")  # from the run to its index, and back
        page.click("a:text('walked')")

        start(page, "Drive", run="walked", track="lake", laps="0.005")
        (drive,) = (tmp_path / "drives").glob("*.mcap")
        with Log(drive) as opened:
            assert opened.metadata["run"] == "walked"
            driven = len(opened.vehicle())
        page.click(f"a:text('{drive.stem}')")
        open_session(page)
        assert f"{driven} rows" in page.inner_text(".title")
        # not by decode(): it fails where the page goes on to another picture meanwhile
        wait_until(lambda: page.locator("figure:not([hidden]) img").first.evaluate("image => image.naturalWidth"))
        assert call(recorder.log_cli.main, "check", drive) == 0
        page.wait_for_selector(".title a:text('walked')")  # the way back to the run


def excluded(log: Path, capsys: pytest.CaptureFixture[str]) -> list[tuple[int, int]]:
    """As `bc-log tag` tells it."""
    capsys.readouterr()
    assert call(recorder.log_cli.main, "tag", log) == 0
    lines = re.findall(r"exclude: rows (\d+) to (\d+)", capsys.readouterr().out)
    return [(int(first), int(last)) for first, last in lines]


def used_rows(folder: Path) -> set[int]:
    samples = pq.read_table(folder / "index" / "samples.parquet", columns=["session", "row"]).to_pylist()
    return {sample["row"] for sample in samples if sample["session"] == "damaged"}
