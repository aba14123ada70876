"""One walk through the workbench, as somebody would go: a session is cleaned, an index made of it, a network
trained, and its drive looked at. What each step has done is checked with the commands and in the files."""

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
from chromium import chromium
from driving import road_jpeg
from logs import write_log
from pages import drag, open_session, opened_page, press
from recorder import Log
from udacity import call
from waiting import wait_until
from workbench import served

if TYPE_CHECKING:
    from playwright.sync_api import Page

ROWS = 600
STUCK = (100, 140)
WORST = (300, 419)


def write_sessions(folder: Path) -> Path:
    """A sound session, and one with two stretches of stuck steering, the second the longer one."""
    steering = 0.4 * np.sin(np.arange(ROWS) / 9)
    write_log(folder / "sound.mcap", steering[:200].tolist(), lambda camera, row: road_jpeg(row))
    for first, last in (STUCK, WORST):
        steering[first : last + 1] = 0.25
    return write_log(folder / "damaged.mcap", steering.tolist(), lambda camera, row: road_jpeg(1000 + row))


def start(page: Page, form: str, **values: str) -> None:
    """Fill one of the forms of the page of jobs, and wait until the command has ended well."""
    page.click("nav >> text=Jobs")
    page.click(f"summary >> text='{form}'")
    within = page.locator("details[open]")
    for name, value in values.items():
        field = within.locator(f"[name={name}]")
        if field.evaluate("field => field.tagName") == "SELECT":
            field.select_option(value)
        else:
            field.fill(value)
    within.locator("button").click()
    page.wait_for_selector("#job .state:not(:text('running'))")
    assert page.inner_text("#job .state") == "done", page.inner_text("pre")
    page.click("text=what it has made")


def test_from_a_damaged_session_to_its_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_sessions(tmp_path / "sessions")
    folders = "--sessions", log.parent, "--index", tmp_path / "index"
    assert call(dataset.cli.main, *folders, "--labels", "as-recorded") == 0
    with (
        chromium() as browser,
        served(tmp_path) as bench,
        opened_page(browser, bench.address) as page,
    ):
        # the session with the most odd rows, and its worst stretch
        page.select_option("[name=sort]", "most odd rows")
        wait_until(lambda: page.locator(".session .name").first.inner_text() == "damaged")
        page.locator(".session .name").first.click()
        open_session(page)
        odd = [
            [int(row) for row in re.findall(r"\d+", line)[:2]]
            for line in page.locator("#odd li").all_inner_texts()
        ]
        assert max(odd, key=lambda rows: rows[1] - rows[0]) == list(WORST)

        rows = drag(page, *WORST, ROWS)
        assert list(rows) == pytest.approx(WORST, abs=3)
        press(page, "x", 1)
        assert excluded(log, capsys) == [rows]
        press(page, "u", 0)
        assert excluded(log, capsys) == []
        assert drag(page, *WORST, ROWS) == rows
        press(page, "x", 1)
        assert excluded(log, capsys) == [rows]

        page.click("nav >> text=Index")
        assert "damaged" in page.inner_text(".problem")  # it is newer than the index
        assert used_rows(tmp_path) & set(range(*rows))
        start(page, "Index", labels="as-recorded")
        assert page.url.endswith("/index")
        assert page.locator(".problem").count() == 0
        page.click("text=Check it for leaks")
        page.wait_for_selector("#leaks:text('no leak')")
        assert call(dataset.cli.main, "--check", *folders) == 0
        assert not used_rows(tmp_path) & set(range(rows[0], rows[1] + 1))

        start(page, "Train", name="walked", epochs="1", network="small")
        page.wait_for_selector("text=1 learnt of 1")
        page.wait_for_selector("#plots[data-shown='walked'] canvas")
        config = json.loads((tmp_path / "runs" / "walked" / "config.json").read_text())
        assert set(config["data"]["logs"]) == {"damaged", "sound"}
        capsys.readouterr()
        assert call(model.runs_cli.main, "--runs", tmp_path / "runs", "--json") == 0
        assert '"walked"' in capsys.readouterr().out

        page.click("text=the one that is here")  # from the run to its index, and back
        page.click("a:text('walked')")

        start(page, "Drive", run="walked", track="lake", laps="0.005")
        (drive,) = (tmp_path / "drives").glob("*.mcap")
        with Log(drive) as found:
            assert found.metadata["run"] == "walked"
            driven = len(found.vehicle())
        page.click(f"text={drive.stem}")
        open_session(page)
        assert f"{driven} rows" in page.inner_text(".title")
        assert page.locator("figure:not([hidden]) img").first.evaluate("image => image.decode().then(() => true)")
        assert call(recorder.log_cli.main, "check", drive) == 0
        page.wait_for_selector(".title a:text('walked')")  # the way back to the run
        page.keyboard.press("o")
        page.wait_for_selector("#rerun[data-shown]")
        assert page.locator("#rerun iframe").count() == 1


def excluded(log: Path, capsys: pytest.CaptureFixture[str]) -> list[tuple[int, int]]:
    """As `bc-log tag` tells it."""
    capsys.readouterr()
    assert call(recorder.log_cli.main, "tag", log) == 0
    lines = re.findall(r"exclude: rows (\d+) to (\d+)", capsys.readouterr().out)
    return [(int(first), int(last)) for first, last in lines]


def used_rows(folder: Path) -> set[int]:
    samples = pq.read_table(folder / "index" / "samples.parquet", columns=["session", "row"]).to_pylist()
    return {sample["row"] for sample in samples if sample["session"] == "damaged"}
